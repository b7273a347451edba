// Over the domain: shows the sample of u_observation, times u_exposure. Alpha is UNUSED where the sample has no weight
// (clipped, in shadow), 0 where no pixel shows the texel. Reads u_packed and the sample stack.

#include "common/packing.glsl"
#include "view/encode.glsl"

bool texel_kernel(ivec2 texel)
{
    ivec2 packed_texel = packed_at(texel);
    o_picture = vec4(0.0);
    if (packed_texel.x < 0) {
        return true;
    }
    vec4 reference = texelFetch(u_stack, ivec3(packed_texel, u_observation), 0);
#ifndef CARD
    // Radiance and weight are 0 where no pixel shows a texel. On a card every texel is a pixel, black ones too.
    if (reference.a <= 0.0 && all(equal(reference.rgb, vec3(0.0)))) {
        return true;
    }
#endif
    o_picture = vec4(srgb_from_linear(u_exposure * reference.rgb), reference.a > 0.0 ? 1.0 : UNUSED);
    return true;
}
