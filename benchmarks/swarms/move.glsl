// Over W × rows·BLOCKS: Eq. 2 and 3 for four dimensions of a particle, as in shaders/swarm/update.glsl.
// With START: a random position and velocity. Reads u_x, u_v, u_best, u_goal (BLOCKS × 1); writes o_x, o_v.

#include "common/random.glsl"
#include "layout.glsl"

// Purposes, as rule.py numbers them.
#define STREAM_R1 0
#define STREAM_R2 1
#define STREAM_POSITION 2
#define STREAM_VELOCITY 3

vec4 uniform_of(int particle, int block, int purpose)
{
    uvec4 key = uvec4(uint(particle), uint(u_iteration), uint(4 * block + purpose), uint(u_seed));
    return vec4(pcg4d(pcg4d(key)) >> 8u) * (1.0 / 16777216.0);
}

bool texel_kernel(ivec2 texel)
{
    int particle = particle_of(texel, u_width);
    int block = texel.y / u_rows;
#ifdef START
    o_x = uniform_of(particle, block, STREAM_POSITION);
    o_v = u_start_speed * (2.0 * uniform_of(particle, block, STREAM_VELOCITY) - 1.0);
#else
    vec4 x = texelFetch(u_x, texel, 0);
    vec4 r1 = uniform_of(particle, block, STREAM_R1);
    vec4 r2 = uniform_of(particle, block, STREAM_R2);
    vec4 pull = u_c1 * r1 * (texelFetch(u_best, texel, 0) - x) + u_c2 * r2 * (texelFetch(u_goal, ivec2(block, 0), 0) - x);
    vec4 v = clamp(u_inertia * texelFetch(u_v, texel, 0) + pull, -u_v_max, u_v_max);
    vec4 target = x + v;
    o_x = clamp(target, 0.0, 1.0);
    o_v = mix(v, vec4(0.0), notEqual(o_x, target));
#endif
    return true;
}
