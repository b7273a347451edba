// Rough diffuse. Oren & Nayar 1994, Generalization of Lambert's Reflectance Model, Eq. 30 (the qualitative model).
// L = ρ/π cosθi (A + B max(0, cos Δφ) sin α tan β), α = max(θi, θr), β = min(θi, θr), σ the spread of facet slopes.

#include "brdf/horizon.glsl"

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    float NoL = dot(s.normal, l);
    float NoV = dot(s.normal, v);
    if (!above_horizon(NoL, NoV)) {
        return vec3(0.0);
    }
    float s2 = s.sigma * s.sigma;
    float A = 1.0 - 0.5 * s2 / (s2 + 0.33);
    float B = 0.45 * s2 / (s2 + 0.09);
    // sinθi sinθr cos Δφ is the product of the parts of l and v along the surface; sin α tan β divides it by the
    // larger cosine.
    float along = dot(l - NoL * s.normal, v - NoV * s.normal);
    return vec3(NoL * (A + B * max(along, 0.0) / max(NoL, NoV)));
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    return s.base_color * basis_base_color(s, l, v);
}
