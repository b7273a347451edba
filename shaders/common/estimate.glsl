// The material of a texel as it is known or estimated now. Reads u_estimate_0 to u_estimate_2: the components of all
// parameters, in the order of the model's table. With ESTIMATES 0 none is bound.

#include "material.glsl"

#if ESTIMATES > 0
Material estimate_at(ivec2 texel)
{
    float c[12];
    vec4 part = texelFetch(u_estimate_0, texel, 0);
    for (int i = 0; i < 4; i++) {
        c[i] = part[i];
    }
#if ESTIMATES > 1
    part = texelFetch(u_estimate_1, texel, 0);
#endif
    for (int i = 0; i < 4; i++) {
        c[4 + i] = part[i];
    }
#if ESTIMATES > 2
    part = texelFetch(u_estimate_2, texel, 0);
#endif
    for (int i = 0; i < 4; i++) {
        c[8 + i] = part[i];
    }
    return material_from(c);
}
#endif
