// Over the canvas of the web page: shows one tile, as a relit render, a map, an uncertainty or a photograph.
// Reads u_planes: the maps (planes.glsl), uncertainties as 1…255 (0 is outside), or a photograph.
// A pixel interpolates the maps of four texels bilinearly and shades once. At a texel's centre the result is the
// radiance that the solver fits.

#include "web/planes.glsl"
#include "model.glsl"
#include "view/encode.glsl"

#define LIT 0
#define PARAMETER 1
#define UNCERTAINTY 2
#define PHOTOGRAPH 3

uniform int u_show;
uniform vec2 u_canvas;        // height of the canvas in pixels, and texels per pixel
uniform vec2 u_corner;        // upper left corner of the canvas in the picture, in texels of the finest level
uniform vec3 u_tile;          // first texel of the tile with its margin of 1, in its level; finest texels per texel
uniform vec3 u_place[3];      // the picture's upper left corner on the card, and the steps of one texel right and down
uniform vec4 u_view;          // camera: position and 1, or direction to it and 0
uniform vec4 u_light;         // light, likewise
uniform vec3 u_intensity;
uniform float u_exposure;
uniform ivec2 u_parameter;    // first and count: components of PARAMETER, channels of UNCERTAINTY
uniform vec3 u_ramp[RAMP];    // colours of uncertainties, at equal steps

out vec4 o_color;

vec3 toward(vec4 place, vec3 position, out float squared)
{
    vec3 d = place.w == 0.0 ? place.xyz : place.xyz - position;
    squared = dot(d, d);
    return d * inversesqrt(squared);
}

vec3 lit(inout float c[MAX_COMPONENTS], vec2 at)
{
    vec3 position = u_place[0] + at.x * u_place[1] + at.y * u_place[2];
    float squared, unused;
    vec3 l = toward(u_light, position, squared);
    vec3 v = toward(u_view, position, unused);
    vec3 intensity = u_light.w == 0.0 ? u_intensity : u_intensity / squared;
    return srgb_from_linear(u_exposure * intensity * reflectance(material_from(c), l, v));
}

vec3 shown_parameter(inout float c[MAX_COMPONENTS])
{
    int at = u_parameter.x;
    if (at == NORMAL) {
        return 0.5 * vec3(c[at], c[at + 1], c[at + 2]) + 0.5;
    }
    vec3 shown = vec3(0.0);
    for (int i = 0; i < min(u_parameter.y, 3); i++) {
        shown[i] = SRGB[at] ? c[at + i] : (c[at + i] - LOW[at]) / SPAN[at];
    }
    if (u_parameter.y == 1) {
        shown = shown.rrr;
    }
    return SRGB[at] ? srgb_from_linear(shown) : shown;
}

vec3 ramp(float x)
{
    float place = clamp(x, 0.0, 1.0) * float(RAMP - 1);
    int below = min(int(place), RAMP - 2);
    return mix(u_ramp[below], u_ramp[below + 1], place - float(below));
}

vec4 maps_at(ivec2 first, vec2 f, vec2 at)
{
    float c[MAX_COMPONENTS];
    for (int i = 0; i < MAX_COMPONENTS; i++) {
        c[i] = 0.0;
    }
    float share = add_texel(first, (1.0 - f.x) * (1.0 - f.y), c) + add_texel(first + ivec2(1, 0), f.x * (1.0 - f.y), c)
                  + add_texel(first + ivec2(0, 1), (1.0 - f.x) * f.y, c) + add_texel(first + ivec2(1), f.x * f.y, c);
    if (share <= 0.0) {
        return vec4(0.0);
    }
    for (int i = 0; i < COMPONENTS; i++) {
        c[i] /= share;
    }
    vec3 n = normalize(vec3(c[NORMAL], c[NORMAL + 1], c[NORMAL + 2]));
    c[NORMAL] = n.x;
    c[NORMAL + 1] = n.y;
    c[NORMAL + 2] = n.z;
    return vec4(u_show == LIT ? lit(c, at) : shown_parameter(c), 1.0) * share;
}

// Returns the colour of the largest of the channels in u_parameter; 0 is outside.
vec4 uncertainty_at(ivec2 texel)
{
    float largest = 0.0;
    for (int i = u_parameter.x; i < u_parameter.x + u_parameter.y; i++) {
        largest = max(largest, bytes_at(texel, i / 3)[i % 3]);
    }
    return largest == 0.0 ? vec4(0.0) : vec4(ramp((largest - 1.0) / 254.0), 1.0);
}

vec3 photograph_at(ivec2 first, vec2 f)
{
    vec3 below = mix(bytes_at(first, 0), bytes_at(first + ivec2(1, 0), 0), f.x);
    vec3 above = mix(bytes_at(first + ivec2(0, 1), 0), bytes_at(first + ivec2(1), 0), f.x);
    vec3 code = mix(below, above, f.y) / 255.0;
    if (u_exposure == 1.0) {
        return code;
    }
    vec3 curve = pow((max(code, vec3(0.04045)) + 0.055) / 1.055, vec3(2.4));
    return srgb_from_linear(u_exposure * mix(curve, code / 12.92, vec3(lessThanEqual(code, vec3(0.04045)))));
}

void main()
{
    vec2 at = u_corner + u_canvas.y * vec2(gl_FragCoord.x, u_canvas.x - gl_FragCoord.y);
    vec2 tap = at / u_tile.z - u_tile.xy - 0.5;
    ivec2 first = ivec2(floor(tap));
    vec2 f = tap - vec2(first);
    if (u_show == PHOTOGRAPH) {
        o_color = vec4(photograph_at(first, f), 1.0);
    } else if (u_show == UNCERTAINTY) {
        o_color = uncertainty_at(ivec2(floor(tap + 0.5)));
    } else {
        o_color = maps_at(first, f, at);
    }
}
