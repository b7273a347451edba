// Writes what common/observation.glsl says of observation u_observation at a texel: o_light (direction, weight),
// o_intensity and o_radiance, with what is clipped in the channels of o_clipped.

#include "common/observation.glsl"

bool texel_kernel(ivec2 texel)
{
    Observation o;
    bool valid = observe(observed_texel(texel), u_observation, o);
    o_light = vec4(o.l, valid ? o.weight : 0.0);
    o_intensity = vec4(o.intensity, 1.0);
    o_radiance = vec4(o.radiance, 1.0);
    o_clipped = vec4(o.clipped, 1.0);
    return true;
}
