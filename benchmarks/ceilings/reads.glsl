// Reads a stack, a layer after another, each texel once.

bool texel_kernel(ivec2 texel)
{
    o_sum = vec4(0.0);
    for (int k = 0; k < u_count; k++) {
        o_sum += texelFetch(u_stack, ivec3(texel, k), 0);
    }
    return true;
}
