// Pass A, over W×H texels: moves one particle of every swarm and evaluates it where it has come to.
// Reads the swarm atlas (u_particle_*), the global bests, the estimates, the geometry and the sample stack.
// Writes the candidate: its place, its velocity, and in o_verdict (fitness, 1 if a personal best, 1 if a global best,
// which particle; −1 where nothing moved).
// With START it places particle u_particle instead of moving a random one.

#include "common/estimate.glsl"
#include "common/random.glsl"
#include "swarm/atlas.glsl"
#include "swarm/fitness.glsl"
#include "swarm/neighbours.glsl"
#include "codec.glsl"

#define WALLS_CLAMP 0
#define WALLS_STOP 1
#define WALLS_REFLECT 2

ivec2 global_texel(ivec2 texel)
{
    return place_of(texel) + ivec2(u_origin_x, u_origin_y);
}

#ifdef START

// Particle 0 of a seeded swarm stands on the estimate itself, further seeded ones around it, the rest anywhere.
void place_particle(ivec2 texel, out float x[8], out float v[8])
{
    float seed[8];
    encode(estimate_at(texel), reach_of(scale_at(texel)), seed);
    for (int block = 0; block < BLOCKS; block++) {
        ivec2 at = global_texel(texel);
        vec4 place = random_uniform(u_seed, u_iteration, at, u_particle, RANDOM_POSITION + block);
        vec4 speed = random_uniform(u_seed, u_iteration, at, u_particle, RANDOM_VELOCITY + block);
        for (int i = 0; i < 4; i++) {
            int d = 4 * block + i;
            float spread = u_particle == 0 ? 0.0 : SEED_SPREAD;
            x[d] = u_particle < u_seeded ? clamp(seed[d] + spread * (2.0 * place[i] - 1.0), 0.0, 1.0) : place[i];
            v[d] = START_SPEED * (2.0 * speed[i] - 1.0);
        }
    }
}

#else

void read_particle(sampler2D atlas, ivec2 texel, int particle, out float x[8])
{
    vec4 part = texelFetch(atlas, atlas_texel(texel, 0, particle), 0);
    for (int i = 0; i < 4; i++) {
        x[i] = part[i];
    }
#if BLOCKS > 1
    part = texelFetch(atlas, atlas_texel(texel, 1, particle), 0);
#endif
    for (int i = 0; i < 4; i++) {
        x[4 + i] = part[i];
    }
}

void move_particle(ivec2 texel, Frame f, int particle, out float x[8], out float v[8])
{
    float p[8];
    float g[8];
    float mean[8];
    read_particle(u_particle_position, texel, particle, x);
    read_particle(u_particle_velocity, texel, particle, v);
    read_particle(u_particle_best, texel, particle, p);
    read_best(texel, g);
    for (int i = 0; i < 8; i++) {
        mean[i] = x[i];
    }
    if (u_c3 != 0.0) {
        neighbourhood_mean(texel, f, mean);
    }
    for (int block = 0; block < BLOCKS; block++) {
        ivec2 at = global_texel(texel);
        vec4 r1 = random_uniform(u_seed, u_iteration, at, particle, RANDOM_R1 + block);
        vec4 r2 = random_uniform(u_seed, u_iteration, at, particle, RANDOM_R2 + block);
        for (int i = 0; i < 4; i++) {
            int d = 4 * block + i;
            // Eq. 2: v ← v + c1 R1 (p − x) + c2 R2 (g − x) + c3 A, with A of Eq. 4; inertia and constriction are 1 in
            // the paper (Shi & Eberhart 1998; Clerc & Kennedy 2002).
            float speed = u_inertia * v[d] + u_c1 * r1[i] * (p[d] - x[d]) + u_c2 * r2[i] * (g[d] - x[d]);
            speed = u_constriction * (speed + u_c3 * (mean[d] - x[d]));
            v[d] = clamp(speed, -u_v_max, u_v_max);
            // Eq. 3: x ← x + v, inside the walls.
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

// Takes the particle to the global best of one of the eight texels around, if that one is solved: what a neighbour has
// found is often right here too, and a swarm caught in a wrong optimum has no other way out.
void try_neighbour(ivec2 texel, Frame f, uint choice, inout float x[8])
{
    int direction = int(choice % 8u);
    direction += direction >= 4 ? 1 : 0;
    ivec2 other = packed_at(place_of(texel) + ivec2(direction % 3 - 1, direction / 3 - 1));
    if (other.x >= 0) {
        read_neighbour(other, texel, f, x);
    }
}

#endif

// Interchangeable lobes stay in rising order, so that a mean over neighbours means something.
void order_lobes(inout float x[8], inout float v[8])
{
#ifdef LOBE_FIRST
    if (x[LOBE_FIRST] > x[LOBE_SECOND]) {
        float kept = x[LOBE_FIRST];
        x[LOBE_FIRST] = x[LOBE_SECOND];
        x[LOBE_SECOND] = kept;
        kept = v[LOBE_FIRST];
        v[LOBE_FIRST] = v[LOBE_SECOND];
        v[LOBE_SECOND] = kept;
#ifdef LOBE_WEIGHT
        x[LOBE_WEIGHT] = 1.0 - x[LOBE_WEIGHT];
        v[LOBE_WEIGHT] = -v[LOBE_WEIGHT];
#endif
    }
#endif
}

bool texel_kernel(ivec2 texel)
{
    o_position_0 = vec4(0.0);
    o_velocity_0 = vec4(0.0);
#if BLOCKS > 1
    o_position_1 = vec4(0.0);
    o_velocity_1 = vec4(0.0);
#endif
    o_verdict = vec4(0.0, 0.0, 0.0, -1.0);
    float best = texelFetch(u_best_fitness, texel, 0).x;
    // A swarm that has reached the threshold h of the paper is done.
    if (state_at(texel) != TEXEL_SOLVED || best <= u_threshold) {
        return true;
    }

    float x[8];
    float v[8];
    Frame f = frame_at(texel);
#ifdef START
    int particle = u_particle;
    place_particle(texel, x, v);
    float personal = UNFIT;
#else
    uvec4 choice = random_bits(u_seed, u_iteration, global_texel(texel), 0, RANDOM_CHOICE) >> 8u;
    int particle = int(choice.x % uint(PARTICLES));
    move_particle(texel, f, particle, x, v);
#if NEIGHBOUR_EVERY > 0
    if ((u_iteration + 1) % NEIGHBOUR_EVERY == 0) {
        try_neighbour(texel, f, choice.y, x);
    }
#endif
    float personal = texelFetch(u_particle_fitness, atlas_texel(texel, 0, particle), 0).x;
#endif
    order_lobes(x, v);

    Material s = estimate_at(texel);
    decode(x, reach_of(scale_at(texel)), s);
    float fitness = fitness_of(texel, f, s);

    o_position_0 = vec4(x[0], x[1], x[2], x[3]);
    o_velocity_0 = vec4(v[0], v[1], v[2], v[3]);
#if BLOCKS > 1
    o_position_1 = vec4(x[4], x[5], x[6], x[7]);
    o_velocity_1 = vec4(v[4], v[5], v[6], v[7]);
#endif
    // A first personal best is taken whatever it is worth: the particle must have been somewhere.
#ifdef START
    bool improved = true;
#else
    bool improved = fitness < personal;
#endif
    bool leads = fitness < best || (u_iteration < 0 && particle == 0);
    o_verdict = vec4(fitness, improved ? 1.0 : 0.0, leads ? 1.0 : 0.0, float(particle));
    return true;
}
