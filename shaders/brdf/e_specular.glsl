// Directional albedo of a dielectric GGX layer: the fraction that Blender's Principled BSDF takes from the base below
// it.

#include "brdf/f_dielectric.glsl"

// Returns A = F0 + (1 − F0) ∫ s(v·h) D_v(h) dh over the visible microfacet normals h that reflect upward, with
// s = (F − F0) / (1 − F0). Cycles tabulates A for its layering (measured against bpy 5.0.1). It is not the albedo of
// the lobe, which loses light between facets. A smooth surface has A = F(n·v). A rough one has A = F(c), with a cosine
// c that is fitted here to numeric integrals over roughness 0.02 to 1, n·v 0 to 1 and F0 0 to 0.08
// (specular_layer_albedo in tests/oracles/reflectance.py): error at most 0.005 where n·v >= 0.09 (0.0006 in the mean),
// 0.017 below. roughness is perceptual (α = roughness²) and > 0, which keeps the divisor positive; F0 <= 0.08.
float E_SpecularLayer(float NoV, float roughness, float F0)
{
    float r = roughness;
    float m = NoV;
    float above = m * (-0.4183 + m * (0.8193 - 8.231 * m)) + r * m * (5.514 + 3.45 * m)
                + r * r * (1.336 - 4.016 * m - 0.8463 * r);
    float below = r + m * (3.508 + 3.157 * m) + r * (0.3903 * m + 0.7437 * r);
    float tint = (F0 + 0.004179) / (F0 + 0.007262);
    float c = sqrt(clamp(m * m + r * r * tint * above / below, 0.0, 1.0));
    return F_Dielectric(c, ior_from_F0(F0));
}
