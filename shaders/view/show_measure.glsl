// Over the domain: shows a measure in false colours, u_ramp from 0 to u_limit. The measure is the largest of
// u_components numbers from u_at on. NaN and infinity get the last colour of u_ramp, which lies beyond its end.
// Reads u_packed and the measures.

#include "common/packing.glsl"
#include "view/measure.glsl"

bool texel_kernel(ivec2 texel)
{
    ivec2 packed_texel = packed_at(texel);
    o_picture = vec4(0.0);
    if (packed_texel.x < 0) {
        return true;
    }
    float value = measure_at(packed_texel, u_at);
    for (int i = 1; i < u_components; i++) {
        value = max(value, measure_at(packed_texel, u_at + i));
    }
    if (value < 0.0) {
        return true;
    }
    int last = textureSize(u_ramp, 0).x - 2;
    if (isnan(value) || isinf(value)) {
        o_picture = texelFetch(u_ramp, ivec2(last + 1, 0), 0);
        return true;
    }
    float ramp_coord = clamp(value / u_limit, 0.0, 1.0) * float(last);
    int knot = min(int(ramp_coord), last - 1);
    vec4 low = texelFetch(u_ramp, ivec2(knot, 0), 0);
    vec4 high = texelFetch(u_ramp, ivec2(knot + 1, 0), 0);
    o_picture = mix(low, high, ramp_coord - float(knot));
    return true;
}
