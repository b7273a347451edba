// Kernel of the GPU probe: arithmetic like that of a fitness, with a result that numpy can check.

bool texel_kernel(ivec2 texel)
{
    float value = float(texel.x + 256 * texel.y) / 65536.0;
    for (int i = 0; i < u_rounds; i++) {
        value = 0.5 * exp(-value * value) + 0.25 * value;
    }
    o_value = vec4(value);
    return true;
}
