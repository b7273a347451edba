// Cosines for microfacet terms, computed without cancellation near the peak of a highlight.

#include "brdf/horizon.glsl"

struct Angles {
    float NoL;
    float NoV;
    float NoH;
    float VoH;    // = l·h
    float sin2_h; // sin² of the angle between n and h
};

// Requires light and view above the horizon: then |l + v| > 2 HORIZON, and its square is not denormal.
Angles angles_of(vec3 n, vec3 l, vec3 v)
{
    vec3 sum = l + v;
    float squared = dot(sum, sum);
    vec3 n_cross_sum = cross(n, sum);
    Angles a;
    a.NoL = dot(n, l);
    a.NoV = dot(n, v);
    a.NoH = (a.NoL + a.NoV) * inversesqrt(squared);
    // |l + v| = 2 cos of half the angle between l and v. 1 + l·v cancels where they are nearly opposite.
    a.VoH = 0.5 * sqrt(squared);
    // 1 − NoH² keeps no digit of an angle below 2e-4. A lobe of roughness 0.02 lies within that angle: Cycles, which
    // computes it so, is off by up to 6 % there.
    a.sin2_h = dot(n_cross_sum, n_cross_sum) / squared;
    return a;
}
