// Lines with round ends, and discs, with antialiased edges (1 pixel). All lengths are in pixels.

#include "window/screen.glsl"

void main()
{
    vec2 along = v_end - v_begin;
    float squared = dot(along, along);
    float t = squared > 0.0 ? clamp(dot(v_place - v_begin, along) / squared, 0.0, 1.0) : 0.0;
    float coverage = clamp(0.5 * u_width + 0.5 - distance(v_place, v_begin + t * along), 0.0, 1.0);
    if (coverage <= 0.0) {
        discard;
        return;
    }
    vec4 color = mix(v_begin_color, v_end_color, t);
    o_color = on_screen(vec4(color.rgb, color.a * coverage));
}
