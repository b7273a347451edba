// Over the domain: what u_observation saw, times u_exposure; alpha 0 where it weighs nothing.
// Reads u_packed and the sample stack.

#include "common/packing.glsl"
#include "view/encode.glsl"

bool texel_kernel(ivec2 texel)
{
    ivec2 at = packed_at(texel);
    o_picture = vec4(0.0);
    if (at.x < 0) {
        return true;
    }
    vec4 reference = texelFetch(u_stack, ivec3(at, u_observation), 0);
    if (reference.a > 0.0) {
        o_picture = vec4(srgb_from_linear(u_exposure * reference.rgb), 1.0);
    }
    return true;
}
