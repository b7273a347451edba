// The cosines that microfacet terms are written in, without the loss of digits that arises near a highlight's peak.

#include "brdf/horizon.glsl"

struct Angles {
    float NoL;
    float NoV;
    float NoH;
    float VoH;    // = l·h
    float sin2_h; // sin² of the angle between n and h
};

// Only for light and view above the horizon: there l + v is longer than 2 HORIZON, so that its square stays normal.
Angles angles_of(vec3 n, vec3 l, vec3 v)
{
    vec3 sum = l + v;
    float squared = dot(sum, sum);
    vec3 across = cross(n, sum);
    Angles a;
    a.NoL = dot(n, l);
    a.NoV = dot(n, v);
    a.NoH = (a.NoL + a.NoV) * inversesqrt(squared);
    // |l + v| = 2 cos of half the angle between them; 1 + l·v would cancel where they are nearly opposite.
    a.VoH = 0.5 * sqrt(squared);
    // 1 − NoH² keeps no digit of an angle below 2e-4, within which all of a lobe of roughness 0.02 lies: Cycles, which
    // computes it so, is off by up to 6 % there.
    a.sin2_h = dot(across, across) / squared;
    return a;
}
