// Writes what common/observation.glsl says of observation u_observation at a texel: o_light (direction, weight),
// o_intensity and o_radiance.

#include "common/observation.glsl"

bool texel_kernel(ivec2 texel)
{
    vec3 l;
    vec3 intensity;
    vec3 radiance;
    float weight = observe(texel, frame_at(texel), u_observation, l, intensity, radiance);
    o_light = vec4(l, weight);
    o_intensity = vec4(intensity, 1.0);
    o_radiance = vec4(radiance, 1.0);
    return true;
}
