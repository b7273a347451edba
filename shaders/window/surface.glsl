// Draws a picture on a surface: u_picture left of the window's column u_split, u_second right of it. Display values,
// nearest texel. Where alpha is below 1 (samples without weight), it draws diagonal stripes, u_stripes pixels apart (0:
// none). Nothing is drawn where alpha is 0 or uv is outside the picture.

#include "window/screen.glsl"

vec4 texel_of(sampler2D picture)
{
    ivec2 size = textureSize(picture, 0);
    // uv = 1 is the outer edge of the last texel.
    return texelFetch(picture, clamp(ivec2(v_uv * vec2(size)), ivec2(0), size - 1), 0);
}

// Draws dark stripes on bright colours and bright stripes on dark colours.
vec3 striped(vec3 color)
{
    float phase = fract((gl_FragCoord.x + gl_FragCoord.y) / u_stripes);
    float luminance = dot(color, vec3(0.2126, 0.7152, 0.0722));
    return phase < 0.35 ? mix(color, vec3(luminance < 0.5 ? 1.0 : 0.0), 0.6) : color;
}

void main()
{
    // 1e-5: where a mesh edge lies on the picture's edge, interpolation may exceed it slightly.
    if (any(greaterThan(abs(v_uv - 0.5), vec2(0.5 + 1e-5)))) {
        discard;
        return;
    }
    vec4 display = gl_FragCoord.x < u_split ? texel_of(u_picture) : texel_of(u_second);
    if (display.a <= 0.0) {
        discard;
        return;
    }
    if (display.a < 1.0 && u_stripes > 0.0) {
        display.rgb = striped(display.rgb);
    }
    o_color = on_screen(vec4(display.rgb, u_opacity));
}
