// Over W×H texels: the relaxed slopes s = s₀ − P Cᵀ μ (relax.glsl). The change is limited to TOLERANCE standard
// deviations of the samples: (s − s₀)ᵀ P⁻¹ (s − s₀) ≤ TOLERANCE².
// Reads u_field, u_covariance and packing. Writes o_field: (s, 0, 0).

#include "common/packing.glsl"
#include "surface/loops.glsl"

float multiplier_at(ivec2 place)
{
    ivec2 other = packed_at(place);
    return other.x >= 0 ? texelFetch(u_field, other, 0).z : 0.0;
}

bool texel_kernel(ivec2 texel)
{
    ivec2 place = domain_texel_of(texel);
    vec4 field = texelFetch(u_field, texel, 0);
    vec2 ct_mu = c_transpose(field.z, multiplier_at(place - ivec2(1, 0)), multiplier_at(place - ivec2(1, 1)),
                             multiplier_at(place - ivec2(0, 1)));
    vec2 delta = covariance_times(texelFetch(u_covariance, texel, 0).xyz, ct_mu);
    float deviance = dot(ct_mu, delta);
    float part = deviance > 0.0 ? min(1.0, TOLERANCE * inversesqrt(deviance)) : 0.0;
    o_field = vec4(field.xy - part * delta, 0.0, 0.0);
    return true;
}
