// Directional albedo of the coat of Blender's Principled BSDF: a GGX lobe of a dielectric of IOR 1.5 with multiple
// reflection. Turquin 2019, Practical Multiple Scattering Compensation for Microfacet Models.

#include "brdf/e_specular.glsl"

// Blender's default Coat IOR.
#define COAT_IOR 1.5

// E = ∫ D V n·l dω of a lobe without Fresnel: the fraction that leaves after one reflection. Fitted to numeric
// integrals (ggx_albedo in tests/oracles/reflectance.py) over roughness 0.02 to 0.6: error at most 0.017, 0.003 in the
// mean. roughness is perceptual (α = roughness²) and in (0, 0.6]. The divisor is a positive definite form of n·v and α;
// E lies between 0.77 and 1.001.
float E_GGX(float NoV, float roughness)
{
    float a = roughness * roughness;
    float m = NoV;
    float lost = m * (0.1945 + m * (0.1761 * m - 0.428)) + a * (0.0234 + m * (0.9081 + 0.77 * m));
    return 1.0 - a * lost / (m * m - 0.2457 * a * m + 1.6195 * a * a);
}

// Fraction of the light lost by one reflection that leaves after more: Fms = F E / (1 − F (1 − E)), with
// cosine-weighted means F of Fresnel and E of the lobe's albedo. Kulla & Conty 2017, Revisiting Physically Based
// Shading at Imageworks: also F = (ior − 1) / (4.08567 + 1.00071 ior), as in Cycles. E: fit, to 0.0005 up to roughness
// 0.6.
float Fms_Coat(float roughness)
{
    float a = roughness * roughness;
    float F = (COAT_IOR - 1.0) / (4.08567 + 1.00071 * COAT_IOR);
    float lost = a * (0.5947 * roughness + a * (1.0653 - 1.486 * a));
    return F * (1.0 - lost) / (1.0 - F * lost);
}

// Returns the factor of multiple reflection on the coat's lobe: up to 1.02.
float coat_gain(float NoV, float roughness)
{
    float E = E_GGX(NoV, roughness);
    return 1.0 + Fms_Coat(roughness) * (1.0 - E) / E;
}

// Returns the fraction that the coat takes from the material below, for one view. Cycles multiplies the albedo of the
// lobe without Fresnel, with multiple reflection, by the mean Fresnel of e_specular.glsl (measured against bpy 5.0.1).
float E_Coat(float NoV, float roughness)
{
    float E = E_GGX(NoV, roughness);
    float F0 = (COAT_IOR - 1.0) / (COAT_IOR + 1.0);
    return (E + Fms_Coat(roughness) * (1.0 - E)) * E_SpecularLayer(NoV, roughness, F0 * F0);
}
