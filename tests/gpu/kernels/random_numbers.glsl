// Writes the random numbers of a texel, particle u_particle and purpose u_purpose: as floats, and as the two halves of
// two of the hashed words, which a float holds exactly.

#include "common/random.glsl"

bool texel_kernel(ivec2 texel)
{
    ivec2 at = texel + ivec2(u_origin_x, u_origin_y);
    o_uniform = random_uniform(u_seed, u_iteration, at, u_particle, u_purpose);
    uvec4 bits = random_bits(u_seed, u_iteration, at, u_particle, u_purpose);
    o_halves = vec4(bits.x >> 16u, bits.x & 0xffffu, bits.w >> 16u, bits.w & 0xffffu);
    return true;
}
