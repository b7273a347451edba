// Brushed surfaces: a metallic–roughness material of IOR 1.5 with a lobe that is wider along its grain, as Cycles
// renders Blender's Principled BSDF with distribution GGX, Anisotropic and Anisotropic Rotation. Burley 2012,
// Physically-Based Shading at Disney. For a given lobe, radiance is linear in the base colour. See ../README.md for the
// contract of a model.
//
// stretch = a cos 4πρ and slant = a sin 4πρ, with Anisotropic a and Anisotropic Rotation ρ (1 is a full turn). A grain
// turned by half a turn is the same grain, so ρ has the period 1/2. If ρ itself were searched, the ends of its range
// would be the same grain, and at a = 0 it would be undefined. The pair avoids both: radiance is smooth at the centre,
// a = 0, and means of pairs are meaningful. In the corners of their square, a > 1 counts as 1, as in Blender.

#include "brdf/d_ggx_anisotropic.glsl"
#include "brdf/principled_layers.glsl"
#include "brdf/tangent.glsl"
#include "brdf/v_smith_ggx_anisotropic.glsl"

#define ANISOTROPIC_IOR 1.5 // of F0_DEFAULT

// Returns αx and αy, along and across the grain. Burley 2012: αx = r² / aspect, αy = r² aspect, aspect = √(1 − 0.9 a).
// Cycles limits α to 1.
vec2 anisotropic_widths(Material s)
{
    float a = min(length(vec2(s.stretch, s.slant)), 1.0);
    float aspect = sqrt(1.0 - 0.9 * a);
    float alpha = s.roughness * s.roughness;
    return vec2(min(alpha / aspect, 1.0), alpha * aspect);
}

// Returns π D V n·l.
float anisotropic_lobe(Material s, Angles a, vec2 widths, vec3 l, vec3 v)
{
    Grain g = turned_grain(grain_of(s.normal), vec2(s.stretch, s.slant));
    vec2 h = xy_of_half(s.normal, g.along, g.across, l, v);
    float D = D_GGXAnisotropic(h.x, h.y, a.NoH, widths.x, widths.y);
    vec3 light = vec3(dot(g.along, l), dot(g.across, l), a.NoL);
    vec3 view = vec3(dot(g.along, v), dot(g.across, v), a.NoV);
    return 3.14159265358979 * D * V_SmithGGXAnisotropic(light, view, widths.x, widths.y) * a.NoL;
}

// Returns π f_r n·l: x per unit of base colour, y independent of the base colour.
vec2 anisotropic_parts(Material s, vec3 l, vec3 v)
{
    if (!above_horizon(dot(s.normal, l), dot(s.normal, v))) {
        return vec2(0.0);
    }
    Angles a = angles_of(s.normal, l, v);
    vec2 widths = anisotropic_widths(s);
    float lobe = anisotropic_lobe(s, a, widths, l, v);
    float edge = grazing(l, v, a.VoH);
    // Cycles looks up the layer's albedo at the roughness of an isotropic lobe of equal αx αy (measured on bpy 5.0.1).
    float roughness = sqrt(sqrt(widths.x * widths.y));
    float diffuse = layered_diffuse(a.NoL, a.NoV, roughness, F0_DEFAULT);
    float base = mix(diffuse, lobe * (1.0 - edge), s.metallic);
    float fixed_part = lobe * mix(F_Dielectric(a.VoH, ANISOTROPIC_IOR), edge, s.metallic);
    return vec2(base, fixed_part);
}

vec3 basis_base_color(Material s, vec3 l, vec3 v)
{
    return vec3(anisotropic_parts(s, l, v).x);
}

vec3 basis_fixed(Material s, vec3 l, vec3 v)
{
    return vec3(anisotropic_parts(s, l, v).y);
}

vec3 reflectance(Material s, vec3 l, vec3 v)
{
    vec2 parts = anisotropic_parts(s, l, v);
    return s.base_color * parts.x + parts.y;
}
