// Counter-based random numbers. Each is a pure function of (seed, iteration, global texel, particle, purpose), so
// results do not depend on how a domain is cut into tiles or a run into steps.
// Hash: pcg4d. Jarzynski & Olano 2020, Hash Functions for GPU Rendering, JCGT 9(3).

uvec4 pcg4d(uvec4 key)
{
    uvec4 h = key * 1664525u + 1013904223u;
    h.x += h.y * h.w;
    h.y += h.z * h.x;
    h.z += h.x * h.y;
    h.w += h.y * h.z;
    h ^= h >> 16u;
    h.x += h.y * h.w;
    h.y += h.z * h.x;
    h.z += h.x * h.y;
    h.w += h.y * h.z;
    return h;
}

// One stream per purpose.
#define RANDOM_CHOICE 0
#define RANDOM_R1 1
#define RANDOM_R2 3
#define RANDOM_POSITION 5
#define RANDOM_VELOCITY 7

uvec4 random_bits(int seed, int iteration, ivec2 global_texel, int particle, int purpose)
{
    uint packed_texel = uint(global_texel.x) | (uint(global_texel.y) << 16u);
    // Hashed twice: one round leaves neighbouring texels correlated in the low bits.
    return pcg4d(pcg4d(uvec4(packed_texel, uint(iteration), uint(particle * 16 + purpose), uint(seed))));
}

// Four numbers uniform in [0, 1), exact multiples of 2⁻²⁴.
vec4 random_uniform(int seed, int iteration, ivec2 global_texel, int particle, int purpose)
{
    return vec4(random_bits(seed, iteration, global_texel, particle, purpose) >> 8u) * (1.0 / 16777216.0);
}
