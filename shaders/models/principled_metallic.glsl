// Principled with metals: a dielectric as models/principled.glsl has it, at Blender's default Specular IOR Level of 0.5,
// mixed by ``metallic`` with a metal, whose GGX lobe has the base colour. As Blender's Principled BSDF with distribution
// GGX and a white Specular Tint renders it in Cycles. See ../README.md for the contract of a model.
// Burley 2012, Physically-Based Shading at Disney. Given metallic, radiance is linear in the base colour, though that is
// in two lobes: diffuse albedo of the one part and, by Schlick's Fresnel, what the other reflects face on.

#include "brdf/angles.glsl"
#include "brdf/d_ggx.glsl"
#include "brdf/e_specular.glsl"
#include "brdf/f_dielectric.glsl"
#include "brdf/fd_lambert.glsl"
#include "brdf/v_smith_ggx.glsl"

#define DIELECTRIC_F0 0.04 // ((ior − 1) / (ior + 1))² of ior = 1.5

// (1 − v·h)⁵, what Schlick 1994 adds toward white at grazing angles. 1 − v·h of a black metal is all that it reflects:
// sin² of the angle is |l − v|² / 4, which does not cancel where light and view are near each other.
float grazing(vec3 l, vec3 v, float VoH)
{
    vec3 apart = l - v;
    float m = 0.25 * dot(apart, apart) / (1.0 + VoH);
    float m2 = m * m;
    return m2 * m2 * m;
}

// π D V n·l: the lobe of a mirror of microfacets.
float lobe(Material s, Angles a)
{
    float alpha = s.roughness * s.roughness;
    return 3.14159265358979 * D_GGX(a.NoH, a.sin2_h, alpha) * V_SmithGGX(a.NoL, a.NoV, alpha) * a.NoL;
}

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    float NoL = dot(s.normal, l);
    float NoV = dot(s.normal, v);
    if (!above_horizon(NoL, NoV)) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    float diffuse = Fd_Lambert(NoL) * (1.0 - E_SpecularLayer(NoV, s.roughness, DIELECTRIC_F0));
    return vec3(mix(diffuse, lobe(s, a) * (1.0 - grazing(l, v, a.VoH)), s.metallic));
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec3(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    float F = mix(F_Dielectric(a.VoH, ior_from_F0(DIELECTRIC_F0)), grazing(l, v, a.VoH), s.metallic);
    return vec3(lobe(s, a) * F);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    return s.base_color * basis_base_color(s, l, v) + basis_fixed(s, l, v);
}
