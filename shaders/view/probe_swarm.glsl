// The swarm of the texel (u_column, u_row) of the domain, one particle per column: rows 0–2 its material,
// rows 3–5 that of its personal best, row 6 its fitness; row 7 the material of the global best in columns 0–2.
// Reads u_packed, the geometry, the estimates, the swarm atlas and the global bests.

#include "common/estimate.glsl"
#include "swarm/atlas.glsl"
#include "swarm/neighbours.glsl"
#include "particle_encoding.glsl"

bool texel_kernel(ivec2 place)
{
    ivec2 at = packed_at(ivec2(u_column, u_row));
    o_numbers = vec4(0.0);
    int particle = min(place.x, PARTICLES - 1);
    if (at.x < 0) {
        return true;
    }
    if (place.y == 6) {
        o_numbers = vec4(texelFetch(u_particle_fitness, atlas_texel(at, 0, particle), 0).x);
        return true;
    }
    float x[8];
    if (place.y < 3) {
        read_particle(u_particle_position, at, particle, x);
    }
    else if (place.y < 6) {
        read_particle(u_particle_best, at, particle, x);
    }
    else {
        read_best(at, x);
    }
    Material s = estimate_at(at);
    decode(x, reach_of(scale_at(at)), s);
    float c[12];
    material_to(s, c);
    int first = 4 * (place.y < 6 ? place.y % 3 : min(place.x, 2));
    for (int i = 0; i < 4; i++) {
        o_numbers[i] = c[first + i];
    }
    return true;
}
