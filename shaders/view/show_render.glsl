// Over the domain: shows the render of the estimates under the light of u_observation, times u_exposure.
// Reads u_packed, the estimates, the geometry and the observation table.

#include "common/estimate.glsl"
#include "common/observation.glsl"
#include "common/packing.glsl"
#include "model.glsl"
#include "view/encode.glsl"

bool texel_kernel(ivec2 texel)
{
    ivec2 packed_texel = packed_at(texel);
    o_picture = vec4(0.0);
    if (packed_texel.x < 0) {
        return true;
    }
    Frame f = frame_at(packed_texel);
    vec3 intensity;
    vec3 l = light_at(f, u_observation, intensity);
    vec3 radiance = intensity * reflectance(estimate_at(packed_texel), l, view_at(f, u_observation));
    o_picture = vec4(srgb_from_linear(u_exposure * radiance), 1.0);
    return true;
}
