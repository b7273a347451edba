// Over the domain: one parameter as a picture. Reads u_packed, the estimates and u_measure: alpha is UNUSED where the
// deviation of the number at u_at is over u_unknown.
// u_at, u_components: which numbers of a material. u_encoding: a fraction of the range from u_low, u_width wide,
// a colour, or a normal. A parameter of one number is grey, of two red and green, of four its first three.

#define ENCODING_FRACTION 0
#define ENCODING_COLOR 1
#define ENCODING_NORMAL 2

#include "common/estimate.glsl"
#include "common/packing.glsl"
#include "view/encode.glsl"
#include "view/measure.glsl"

bool texel_kernel(ivec2 texel)
{
    ivec2 at = packed_at(texel);
    o_picture = vec4(0.0);
    if (at.x < 0) {
        return true;
    }
    float c[12];
    material_to(estimate_at(at), c);
    vec3 value = vec3(0.0);
    for (int i = 0; i < min(u_components, 3); i++) {
        value[i] = c[u_at + i];
    }
    if (u_components == 1) {
        value = vec3(value.x);
    }
    if (u_encoding == ENCODING_NORMAL) {
        // 1e-12: a vector without length has no direction.
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
    o_picture = vec4(value, measure_at(at, u_at) > u_unknown ? UNUSED : 1.0);
    return true;
}
