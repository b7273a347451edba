// Reads out the swarm of the texel (u_column, u_row) of the domain, one particle per column: rows 0–2 its material,
// rows 3–5 the material of its personal best, row 6 its fitness; row 7 the material of the global best in columns 0–2.
// Reads u_packed, the geometry, the estimates, the swarm atlas and the global bests.

#include "common/estimate.glsl"
#include "swarm/atlas.glsl"
#include "swarm/neighbours.glsl"
#include "particle_encoding.glsl"

bool texel_kernel(ivec2 place)
{
    ivec2 packed_texel = packed_at(ivec2(u_column, u_row));
    o_numbers = vec4(0.0);
    int particle = min(place.x, PARTICLES - 1);
    if (packed_texel.x < 0) {
        return true;
    }
    if (place.y == 6) {
        o_numbers = vec4(texelFetch(u_particle_fitness, atlas_texel(packed_texel, 0, particle), 0).x);
        return true;
    }
    float x[MAX_DIMENSIONS];
    if (place.y < 3) {
        read_particle(u_particle_position, packed_texel, particle, x);
    }
    else if (place.y < 6) {
        read_particle(u_particle_best, packed_texel, particle, x);
    }
    else {
        read_best(packed_texel, x);
    }
    Material s = estimate_at(packed_texel);
    decode(x, albedo_limit_of(radiance_scale_at(packed_texel)), s);
    float c[MAX_COMPONENTS];
    material_to(s, c);
    int first = 4 * (place.y < 6 ? place.y % 3 : min(place.x, 2));
    for (int i = 0; i < 4; i++) {
        o_numbers[i] = c[first + i];
    }
    return true;
}
