// Converts display values to frame buffer values. Blender sets srgbTarget if the buffer encodes linear values itself,
// as in the viewport and the image editor. The curve: IEC 61966-2-1.

vec4 on_screen(vec4 display)
{
    if (!srgbTarget) {
        return display;
    }
    vec3 c = max(display.rgb, vec3(0.0));
    vec3 curve = pow((c + 0.055) / 1.055, vec3(2.4));
    return vec4(mix(curve, c / 12.92, vec3(lessThanEqual(c, vec3(0.04045)))), display.a);
}
