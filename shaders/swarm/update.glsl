// New position of a particle: its initial position, Eq. 2–3 of the paper, or the global best of a neighbour.
// Reads the swarm atlas (u_particle_*), the global bests, the estimates and the packing.

#include "common/estimate.glsl"
#include "common/random.glsl"
#include "swarm/atlas.glsl"
#include "swarm/neighbours.glsl"
#include "particle_encoding.glsl"

#define WALLS_CLAMP 0
#define WALLS_STOP 1
#define WALLS_REFLECT 2

ivec2 global_texel(ivec2 texel)
{
    return domain_texel_of(texel) + ivec2(u_origin_x, u_origin_y);
}

#ifdef START

// Initial position and velocity. If u_start_count > 0, particle 0 starts at the estimate, and particles up to
// u_start_count − 1 near it in the dimensions whose bit is set in u_start_dimensions. All other coordinates are random.
void initialise_particle(ivec2 texel, int particle, out float x[MAX_DIMENSIONS], out float v[MAX_DIMENSIONS])
{
    float start[MAX_DIMENSIONS];
    encode(estimate_at(texel), albedo_limit_of(radiance_scale_at(texel)), start);
    for (int block = 0; block < BLOCKS; block++) {
        ivec2 coord = global_texel(texel);
        vec4 position = random_uniform(u_seed, u_iteration, coord, particle, RANDOM_POSITION + block);
        vec4 velocity = random_uniform(u_seed, u_iteration, coord, particle, RANDOM_VELOCITY + block);
        for (int i = 0; i < 4; i++) {
            int d = 4 * block + i;
            float spread = particle == 0 ? 0.0 : u_start_spread;
            bool starts_near = particle < u_start_count && (particle == 0 || ((u_start_dimensions >> d) & 1) == 1);
            x[d] = starts_near ? clamp(start[d] + spread * (2.0 * position[i] - 1.0), 0.0, 1.0) : position[i];
            v[d] = u_start_speed * (2.0 * velocity[i] - 1.0);
        }
    }
}

#else

void move_particle(ivec2 texel, int particle, inout float mean[MAX_DIMENSIONS], out float x[MAX_DIMENSIONS],
                   out float v[MAX_DIMENSIONS])
{
    float p[MAX_DIMENSIONS];
    float g[MAX_DIMENSIONS];
    read_particle(u_particle_position, texel, particle, x);
    read_particle(u_particle_velocity, texel, particle, v);
    read_particle(u_particle_best, texel, particle, p);
    read_best(texel, g);
    for (int block = 0; block < BLOCKS; block++) {
        ivec2 coord = global_texel(texel);
        vec4 r1 = random_uniform(u_seed, u_iteration, coord, particle, RANDOM_R1 + block);
        vec4 r2 = random_uniform(u_seed, u_iteration, coord, particle, RANDOM_R2 + block);
        for (int i = 0; i < 4; i++) {
            int d = 4 * block + i;
            // Eq. 2: v ← v + c1 R1 (p − x) + c2 R2 (g − x) + c3 A, with A of Eq. 4; inertia and constriction are 1 in
            // the paper (Shi & Eberhart 1998; Clerc & Kennedy 2002).
            float velocity = u_inertia * v[d] + u_c1 * r1[i] * (p[d] - x[d]) + u_c2 * r2[i] * (g[d] - x[d]);
            velocity = u_constriction * (velocity + (u_c3 != 0.0 ? u_c3 * (mean[d] - x[d]) : 0.0));
            v[d] = clamp(velocity, -u_v_max, u_v_max);
            // Eq. 3: x ← x + v, clamped to [0, 1].
            float target = x[d] + v[d];
            x[d] = clamp(target, 0.0, 1.0);
#if WALLS == WALLS_STOP
            v[d] = target == x[d] ? v[d] : 0.0;
#elif WALLS == WALLS_REFLECT
            v[d] = target == x[d] ? v[d] : -v[d];
#endif
        }
    }
}

// Moves the particle to the global best of one of the eight adjacent texels, if that texel is solved. A neighbour's
// best often fits here too. A swarm that has converged to a wrong optimum cannot leave it otherwise.
void try_neighbour(ivec2 texel, Frame f, int direction, inout float x[MAX_DIMENSIONS])
{
    direction += direction >= 4 ? 1 : 0;
    ivec2 other = neighbour_at(surface_place_of(texel), ivec2(direction % 3 - 1, direction / 3 - 1));
    if (other.x >= 0) {
        read_neighbour(other, texel, f, x);
    }
}

#endif

// Keeps interchangeable lobes in rising order, so that means over neighbours are meaningful.
void order_lobes(inout float x[MAX_DIMENSIONS], inout float v[MAX_DIMENSIONS])
{
#ifdef LOBE_FIRST
    if (x[LOBE_FIRST] > x[LOBE_SECOND]) {
        float swapped = x[LOBE_FIRST];
        x[LOBE_FIRST] = x[LOBE_SECOND];
        x[LOBE_SECOND] = swapped;
        swapped = v[LOBE_FIRST];
        v[LOBE_FIRST] = v[LOBE_SECOND];
        v[LOBE_SECOND] = swapped;
#ifdef LOBE_WEIGHT
        x[LOBE_WEIGHT] = 1.0 - x[LOBE_WEIGHT];
        v[LOBE_WEIGHT] = -v[LOBE_WEIGHT];
#endif
    }
#endif
}
