// Encodes linear values for display. IEC 61966-2-1.

// Alpha of texels that are drawn with stripes: samples without weight, unknown numbers.
const float UNUSED = 0.5;

vec3 srgb_from_linear(vec3 linear)
{
    // NaN has no weight in a stack and is not drawn. max() stops its propagation.
    vec3 c = clamp(linear, vec3(0.0), vec3(1.0));
    vec3 curve = 1.055 * pow(max(c, vec3(0.0031308)), vec3(1.0 / 2.4)) - 0.055;
    return mix(curve, 12.92 * c, vec3(lessThanEqual(c, vec3(0.0031308))));
}
