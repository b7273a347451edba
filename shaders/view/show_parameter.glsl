// Over the domain: shows one parameter. Reads u_packed, the estimates and the measures. Alpha is UNUSED where
// deviation of number u_at exceeds u_unknown.
// u_at, u_components: first number and count. u_encoding: a fraction of the range (u_low, u_width), a colour, or a
// normal. One number is shown as grey, two as red and green, four as their first three.

#define ENCODING_FRACTION 0
#define ENCODING_COLOR 1
#define ENCODING_NORMAL 2

#include "common/estimate.glsl"
#include "common/packing.glsl"
#include "view/encode.glsl"
#include "view/measure.glsl"

bool texel_kernel(ivec2 texel)
{
    ivec2 packed_texel = packed_at(texel);
    o_picture = vec4(0.0);
    if (packed_texel.x < 0) {
        return true;
    }
    float c[MAX_COMPONENTS];
    material_to(estimate_at(packed_texel), c);
    vec3 value = vec3(0.0);
    for (int i = 0; i < min(u_components, 3); i++) {
        value[i] = c[u_at + i];
    }
    if (u_components == 1) {
        value = vec3(value.x);
    }
    if (u_encoding == ENCODING_NORMAL) {
        // 1e-12: a zero vector has no direction.
        value = 0.5 * value * inversesqrt(max(dot(value, value), 1e-12)) + 0.5;
    }
    else if (u_encoding == ENCODING_COLOR) {
        value = srgb_from_linear(value);
    }
    else {
        value = clamp((value - u_low) / u_width, vec3(0.0), vec3(1.0));
        if (u_components == 2) {
            value.z = 0.0;
        }
    }
    o_picture = vec4(value, measure_at(packed_texel, u_at) > u_unknown ? UNUSED : 1.0);
    return true;
}
