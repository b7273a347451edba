// Over the domain: the render of the estimates under the light of u_observation, times u_exposure.
// Reads u_packed, the estimates, the geometry and the observation table.

#include "common/estimate.glsl"
#include "common/observation.glsl"
#include "common/packing.glsl"
#include "model.glsl"
#include "view/encode.glsl"

bool texel_kernel(ivec2 texel)
{
    ivec2 at = packed_at(texel);
    o_picture = vec4(0.0);
    if (at.x < 0) {
        return true;
    }
    Frame f = frame_at(at);
    vec3 intensity;
    vec3 l = light_at(f, u_observation, intensity);
    vec3 radiance = intensity * reflectance(estimate_at(at), l, view_at(f, u_observation));
    o_picture = vec4(srgb_from_linear(u_exposure * radiance), 1.0);
    return true;
}
