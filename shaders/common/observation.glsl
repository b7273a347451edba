// Light and view of an observation, at a texel.
// Reads u_observation_table, K columns: row 0 light (xyz, 1 for a position), row 1 intensity, row 2 view likewise.

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
