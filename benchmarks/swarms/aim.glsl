// Over BLOCKS × 1: the global best position. Reads u_best and u_from (1 × 1: value and particle); writes o_goal.

#include "layout.glsl"

bool texel_kernel(ivec2 texel)
{
    int particle = int(texelFetch(u_from, ivec2(0), 0).y);
    o_goal = texelFetch(u_best, place_of_block(particle, texel.x, u_width), 0);
    return true;
}
