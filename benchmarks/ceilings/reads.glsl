// Measures the bandwidth: reads each texel of u_stack once, layer by layer, and writes the sum to o_sum.

bool texel_kernel(ivec2 texel)
{
    o_sum = vec4(0.0);
    for (int k = 0; k < u_count; k++) {
        o_sum += texelFetch(u_stack, ivec3(texel, k), 0);
    }
    return true;
}
