// Measures the arithmetic rate: four independent chains of vec4 multiply-adds. Reads u_count, u_factor; writes o_sum.

bool texel_kernel(ivec2 texel)
{
    vec4 a = vec4(texel.xyxy);
    vec4 b = a + 1.0;
    vec4 c = a + 2.0;
    vec4 d = a + 3.0;
    for (int i = 0; i < u_count; i++) {
        a = a * u_factor + 1.0;
        b = b * u_factor + 1.0;
        c = c * u_factor + 1.0;
        d = d * u_factor + 1.0;
    }
    o_sum = a + b + c + d;
    return true;
}
