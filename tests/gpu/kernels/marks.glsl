// Writes where it runs: (x, y, u_mark, u_scale) to o_0, and OUTPUTS − 1 further outputs that name themselves.
// Leaves texels as they are where (x + y) is a multiple of u_skip.

bool texel_kernel(ivec2 texel)
{
    o_0 = vec4(texel, u_mark, u_scale);
#if OUTPUTS > 1
    o_1 = float(1000 * texel.y + texel.x);
#endif
#if OUTPUTS > 2
    o_2 = vec4(2.0) + o_0;
#endif
#if OUTPUTS > 3
    o_3 = vec4(3.0) + o_0;
#endif
#if OUTPUTS > 4
    o_4 = vec4(4.0) + o_0;
#endif
#if OUTPUTS > 5
    o_5 = vec4(5.0) + o_0;
#endif
    return u_skip == 0 || (texel.x + texel.y) % u_skip != 0;
}
