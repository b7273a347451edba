// Light and view of an observation, at a texel, and what was seen there.
// Reads u_observation_table, K columns: row 0 light (xyz, 1 for a position), row 1 intensity, row 2 view likewise; and
// u_stack, one layer an observation: RGB radiance, weight.

#include "common/frame.glsl"

// Returns the unit direction toward the light in the texel's frame, and its irradiance over π there.
vec3 light_at(Frame f, int k, out vec3 intensity)
{
    vec4 light = texelFetch(u_observation_table, ivec2(k, 0), 0);
    intensity = texelFetch(u_observation_table, ivec2(k, 1), 0).rgb;
#ifdef DISTANT_LIGHTS
    return to_local(f, light.xyz);
#else
    if (light.w == 0.0) {
        return to_local(f, light.xyz);
    }
    vec3 toward = light.xyz - f.position;
    float squared = dot(toward, toward);
    intensity /= squared;
    return to_local(f, toward * inversesqrt(squared));
#endif
}

// Returns the unit direction toward the camera in the texel's frame.
vec3 view_at(Frame f, int k)
{
    vec4 view = texelFetch(u_observation_table, ivec2(k, 2), 0);
    return to_local(f, view.w == 0.0 ? view.xyz : normalize(view.xyz - f.position));
}

// Returns the weight of an observation, 0 where it tells nothing of this texel, and otherwise its light and radiance.
// With GREY the radiance is that under a light of intensity 1, the mean of the channels that the light has, and what is
// under GREY_SHADOW of the texel's scale is taken for shadow.
float observe(ivec2 texel, Frame f, int k, out vec3 l, out vec3 intensity, out vec3 radiance)
{
    vec4 reference = texelFetch(u_stack, ivec3(texel, k), 0);
    l = vec3(0.0);
    intensity = vec3(0.0);
    radiance = reference.rgb;
    if (reference.a <= 0.0) {
        return 0.0;
    }
    l = light_at(f, k, intensity);
#ifdef GREY
    vec3 has = vec3(greaterThan(intensity, vec3(0.0)));
    float channels = dot(has, vec3(1.0));
    if (channels == 0.0) {
        return 0.0;
    }
    // A channel that the light lacks is divided by 1 and counts nothing.
    radiance = vec3(dot(has * radiance, 1.0 / mix(vec3(1.0), intensity, has)) / channels);
    intensity = vec3(1.0);
    if (radiance.r < GREY_SHADOW * scale_at(texel)) {
        return 0.0;
    }
#endif
    return reference.a;
}
