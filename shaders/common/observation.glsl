// Light, view and sample of one observation at a texel. Reads u_observation_table, one column per observation: row 0
// light (xyz; w is 1 for a position, 0 for a direction), row 1 intensity, row 2 view (as row 0); and u_stack, one layer
// per observation: RGB radiance, weight.

#include "common/frame.glsl"

// Returns the unit direction toward the light in the texel's frame. intensity: irradiance / π at the texel.
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

// A texel and its frame. v: direction toward the camera, if all observations share one camera;
// radiance_scale: radiance_scale_at(); shadow: a sample that is darker under a light of intensity 1 counts as shadow
// (radiance).
struct Texel {
    ivec2 at;
    Frame frame;
    vec3 v;
    float radiance_scale;
    float shadow;
};

Texel observed_texel(ivec2 at)
{
    Texel t;
    t.at = at;
    t.frame = frame_at(at);
    t.v = vec3(0.0);
#ifdef ONE_VIEW
    t.v = view_at(t.frame, 0);
#endif
    t.radiance_scale = radiance_scale_at(at);
    t.shadow = shadow_at(at) * t.radiance_scale;
    return t;
}

// One sample of a texel. l, v: unit directions to light and camera in the texel's frame; intensity: irradiance / π at
// the texel; clipped: 1 in the channels whose radiance is a lower bound.
struct Observation {
    float weight;
    vec3 l;
    vec3 v;
    vec3 intensity;
    vec3 radiance;
    vec3 clipped;
#ifdef GREY
    vec3 lit_channels;  // 1 in those that the light has
#endif
};

// Reads observation k. Returns false if it has no weight at this texel.
// In u_stack a negative weight −(b + w / 2) marks clipped channels: bits 1, 2 and 4 of b stand for red, green and blue,
// w in (0, 1] is the weight. b = 0 marks a sample in shadow, which counts only with WITH_SHADOW.
// With GREY the radiance is normalised to a light of intensity 1 and averaged over the channels that the light has.
// Below GREY_SHADOW times the texel's scale it counts as shadow. One clipped channel makes the mean a lower bound.
bool observe(Texel t, int k, out Observation o)
{
    vec4 reference = texelFetch(u_stack, ivec3(t.at, k), 0);
    o.weight = reference.a;
    o.l = vec3(0.0);
    o.v = t.v;
    o.intensity = vec3(0.0);
    o.radiance = reference.rgb;
    o.clipped = vec3(0.0);
#ifdef WITH_SHADOW
    if (reference.a == 0.0) {
        return false;
    }
#else
    if (reference.a == 0.0 || (reference.a < 0.0 && reference.a > -1.0)) {
        return false;
    }
#endif
    if (reference.a < 0.0) {
        int bits = int(-reference.a);
        o.weight = 2.0 * (-reference.a - float(bits));
        o.clipped = vec3(bits & 1, (bits >> 1) & 1, (bits >> 2) & 1);
#ifdef GREY
        o.clipped = vec3(min(bits, 1));
#endif
    }
    o.l = light_at(t.frame, k, o.intensity);
#ifndef ONE_VIEW
    o.v = view_at(t.frame, k);
#endif
#ifdef GREY
    o.lit_channels = vec3(greaterThan(o.intensity, vec3(0.0)));
    float channels = dot(o.lit_channels, vec3(1.0));
    if (channels == 0.0) {
        return false;
    }
    // A channel in which the light is 0 has no weight. Its divisor, 1, is arbitrary.
    vec3 divisor = mix(vec3(1.0), o.intensity, o.lit_channels);
    o.radiance = vec3(dot(o.lit_channels * o.radiance, 1.0 / divisor) / channels);
    o.intensity = vec3(1.0);
    if (o.radiance.r < GREY_SHADOW * t.radiance_scale) {
        return false;
    }
#endif
    // Where the shadow limit is 0, samples below 0 and NaN count.
    bool dark = dot(o.radiance, vec3(1.0)) < t.shadow * dot(o.intensity, vec3(1.0));
    return !(dark && t.shadow > 0.0);
}

// Loops over the observations with a weight at a texel. A statement or block that uses o follows.
#define EACH_OBSERVATION(t, o) for (int k = 0; k < u_observations; k++) if (observe(t, k, o))

// Returns render minus sample, for the reflectance ρ. A clipped channel has no error where the render is brighter.
vec3 error_of(Observation o, vec3 rho)
{
    vec3 error = o.intensity * rho - o.radiance;
    return mix(error, min(error, vec3(0.0)), o.clipped);
}

// Returns 1 in the channels that constrain the fit, 0 in clipped channels whose lower bound the render satisfies.
vec3 active_channels(Observation o, vec3 error)
{
    return vec3(1.0) - o.clipped * vec3(greaterThanEqual(error, vec3(0.0)));
}
