// Over W × rows·BLOCKS, in place: a particle's position becomes its best, if its value is its least so far.
// Reads u_x, u_value and u_least; writes o_best.

#include "layout.glsl"

bool texel_kernel(ivec2 texel)
{
    ivec2 own = ivec2(texel.x, texel.y % u_rows);
    if (texelFetch(u_value, own, 0).x > texelFetch(u_least, own, 0).x) {
        return false;
    }
    o_best = texelFetch(u_x, texel, 0);
    return true;
}
