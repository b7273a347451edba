// Maps of a tile as bytes, written by exports/web/planes.py. u_planes, layer 0: the normal, octahedral (Cigolle et al.
// 2014, A Survey of Efficient Representations for Independent Unit Vectors), 12 bits each: the upper eight of u in red,
// those of v in green, the lower four of both in blue; 0 where the texel is outside. Layers from 1: the model's other
// components, three per layer, as the square root of their fraction of the range. exports/web/planes.py also writes
// "web/layout.glsl": PLANES, COMPONENTS, NORMAL (its first component), LOW and SPAN of the ranges, and SRGB: whether a
// picture of the component is encoded as sRGB.

#include "common/limits.glsl"
#include "web/layout.glsl"

uniform highp sampler2DArray u_planes;

vec3 bytes_at(ivec2 at, int layer)
{
    return floor(255.0 * texelFetch(u_planes, ivec3(at, layer), 0).rgb + 0.5);
}

vec3 normal_of(vec3 bytes)
{
    float high = floor(bytes.b / 16.0);
    vec2 place = (16.0 * bytes.rg + vec2(high, bytes.b - 16.0 * high)) * (2.0 / 4095.0) - 1.0;
    vec3 n = vec3(place, 1.0 - abs(place.x) - abs(place.y));
    if (n.z < 0.0) {
        n.xy = (1.0 - abs(n.yx)) * mix(vec2(-1.0), vec2(1.0), greaterThanEqual(n.xy, vec2(0.0)));
    }
    return normalize(n);
}

// Adds the components of a texel, times ``share``. Returns the share added: 0 where the texel is outside.
float add_texel(ivec2 at, float share, inout float c[MAX_COMPONENTS])
{
    vec3 normal_bytes = bytes_at(at, 0);
    if (normal_bytes == vec3(0.0)) {
        return 0.0;
    }
    vec3 n = normal_of(normal_bytes);
    int next = 0;
    vec3 root = vec3(0.0);
    for (int i = 0; i < COMPONENTS; i++) {
        if (i >= NORMAL && i < NORMAL + 3) {
            c[i] += share * n[i - NORMAL];
            continue;
        }
        if (next % 3 == 0) {
            root = bytes_at(at, 1 + next / 3) / 255.0;
        }
        c[i] += share * (LOW[i] + SPAN[i] * root[next % 3] * root[next % 3]);
        next++;
    }
    return share;
}
