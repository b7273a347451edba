// Over W×H texels: radiance of each texel toward the camera of one observation under its light: the paper's R(p̂) = ĉ.
// Reads the estimates, the geometry and the observation table. Alpha is 1 where the texel is covered.

#include "common/estimate.glsl"
#include "common/observation.glsl"
#include "model.glsl"

bool texel_kernel(ivec2 texel)
{
    o_radiance = vec4(0.0);
    if (state_at(texel) == TEXEL_OUTSIDE) {
        return true;
    }
    Frame f = frame_at(texel);
    vec3 intensity;
    vec3 l = light_at(f, u_observation, intensity);
    vec3 v = view_at(f, u_observation);
    o_radiance = vec4(intensity * reflectance(estimate_at(texel), l, v), 1.0);
    return true;
}
