// Over W×H texels: the estimates with the normals of the relaxed slopes, s₀ − P Cᵀ μ (relax.glsl). A texel moves no
// further than where its samples would become less likely by TOLERANCE standard deviations: (s − s₀)ᵀ P⁻¹ (s − s₀) ≤
// TOLERANCE². The linear parameters follow to their optimum beside the new normal, to first order. Where the samples'
// deviance would rise by more than TOLERANCE², the estimate stays.
// Reads the estimates, the samples, u_noise (x: loss of the estimate), u_field, u_covariance, geometry and packing.
// Writes o_estimate.

#include "common/estimate.glsl"
#include "surface/normal_matrix.glsl"
#include "surface/slopes.glsl"
#include "surface/loops.glsl"
#include "prior/loss_unit.glsl"

float multiplier_at(ivec2 place)
{
    ivec2 there = packed_at(place);
    return there.x >= 0 ? texelFetch(u_field, there, 0).z : 0.0;
}

// Puts a normal in, and lets the linear parameters follow.
void follow(ivec2 texel, vec3 n, inout float c[12])
{
    float a[FREE_COUNT * FREE_COUNT];
    eliminated(texel, c, a);
    int at = NORMAL_COMPONENT;
    vec3 before = vec3(c[at], c[at + 1], c[at + 2]);
    vec3 axis = turning_axis(before);
    vec2 by = vec2(dot(n, axis), dot(n, cross(before, axis))) / (dot(n, before) * free_at(NORMAL_FREE).width);
    for (int u = 0; u < FREE_COUNT; u++) {
        if (!is_normal(u)) {
            FreeParameter free = free_at(u);
            int entry = u * FREE_COUNT + NORMAL_FREE;
            float moved_by = -free.width * dot(vec2(a[entry], a[entry + 1]), by);
            c[free.at] = clamp(c[free.at] + moved_by, free.low, free.low + free.width);
        }
    }
    c[at] = n.x;
    c[at + 1] = n.y;
    c[at + 2] = n.z;
}

bool fits(ivec2 texel, inout float c[12])
{
    vec4 noise = texelFetch(u_noise, texel, 0);
    float weights;
    float fitness = fitness_of(observed_texel(texel), material_from(c), weights);
    return 3.0 * weights * fitness <= (noise.x + TOLERANCE * TOLERANCE * deviance_unit(noise.w)) * loss_unit(texel);
}

bool texel_kernel(ivec2 texel)
{
    float c[12];
    material_to(estimate_at(texel), c);
    if (state_at(texel) == TEXEL_SOLVED) {
        ivec2 place = domain_texel_of(texel);
        vec4 field = texelFetch(u_field, texel, 0);
        vec2 pull = pull_of(field.z, multiplier_at(place - ivec2(1, 0)), multiplier_at(place - ivec2(1, 1)),
                            multiplier_at(place - ivec2(0, 1)));
        vec2 by = times(texelFetch(u_covariance, texel, 0).xyz, pull);
        float deviance = dot(pull, by);
        if (deviance > 0.0) {
            by *= min(1.0, TOLERANCE * inversesqrt(deviance));
            follow(texel, normal_of(grid_at(texel), field.xy - by), c);
            if (!fits(texel, c)) {
                material_to(estimate_at(texel), c);
            }
        }
    }
    write_estimate(c);
    return true;
}
