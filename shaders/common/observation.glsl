// Light, view and sample of an observation at a texel.
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

// A texel and its frame. v: direction toward the camera, if all observations share one; scale: scale_at(); shadow: the
// radiance under a light of intensity 1 below which a sample counts as shadow.
struct Texel {
    ivec2 at;
    Frame frame;
    vec3 v;
    float scale;
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
    t.scale = scale_at(at);
    t.shadow = shadow_at(at) * t.scale;
    return t;
}

// One sample of a texel. l, v: unit directions to light and camera in the texel's frame; intensity: irradiance over π
// there; clipped: 1 in the channels whose radiance is a lower bound.
struct Observation {
    float weight;
    vec3 l;
    vec3 v;
    vec3 intensity;
    vec3 radiance;
    vec3 clipped;
};

// Reads observation k; returns false if it has no weight at this texel.
// In u_stack a negative weight −(b + w / 2) marks bounds: bits 1, 2 and 4 of b for red, green and blue, w in (0, 1]. With
// b = 0 the sample is in shadow, and counts WITH_SHADOW alone.
// With GREY the radiance is normalised to a light of intensity 1 and averaged over the channels that the light has; below
// GREY_SHADOW of the texel's scale it counts as shadow; one clipped channel makes the mean a bound.
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
    vec3 has = vec3(greaterThan(o.intensity, vec3(0.0)));
    float channels = dot(has, vec3(1.0));
    if (channels == 0.0) {
        return false;
    }
    // A channel that the light lacks has no weight: its divisor 1 is arbitrary.
    o.radiance = vec3(dot(has * o.radiance, 1.0 / mix(vec3(1.0), o.intensity, has)) / channels);
    o.intensity = vec3(1.0);
    if (o.radiance.r < GREY_SHADOW * t.scale) {
        return false;
    }
#endif
    // Samples below 0, and those that are not numbers, count where no shadow is raised.
    bool dark = dot(o.radiance, vec3(1.0)) < t.shadow * dot(o.intensity, vec3(1.0));
    return !(dark && t.shadow > 0.0);
}

// Loops over the observations of a texel that have a weight: a statement or block with o follows.
#define EACH_OBSERVATION(t, o) for (int k = 0; k < u_observations; k++) if (observe(t, k, o))

// The error of a render of reflectance ρ. A bound is met by any brighter render.
vec3 error_of(Observation o, vec3 rho)
{
    vec3 error = o.intensity * rho - o.radiance;
    return mix(error, min(error, vec3(0.0)), o.clipped);
}

// 1 in the channels that constrain the fit, 0 in bounds that are met.
vec3 active_channels(Observation o, vec3 error)
{
    return vec3(1.0) - o.clipped * vec3(greaterThanEqual(error, vec3(0.0)));
}
