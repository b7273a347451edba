// Penalty of a Gaussian prior over the parameters of free_parameters.glsl: Σ (x − m)² / v, a deviance, converted to
// losses (loss_unit.glsl). Reads u_noise and the prior: u_mean, and u_deviation, which is 0 without a prior.

#include "spatial_prior/loss_unit.glsl"
#include "free_parameters.glsl"

float penalty_of(ivec2 texel, inout float c[MAX_COMPONENTS])
{
    float mean[MAX_COMPONENTS];
    float deviation[MAX_COMPONENTS];
    read_mean(texel, mean);
    read_deviation(texel, deviation);
    float sum = 0.0;
    for (int i = 0; i < COMPONENTS; i++) {
        if (deviation[i] > 0.0) {
            float d = (c[i] - mean[i]) / deviation[i];
            sum += d * d;
        }
    }
    return sum * deviance_unit(texelFetch(u_noise, texel, 0).w) * loss_unit(texel);
}

// Adds the prior to the normal equations, J per range. JᵀWJ and JᵀWe are half the second and half the first derivative:
// of n σ² (noise of variance σ²) for losses that are squares, of n σ² / b for l1.
void add_penalty(ivec2 texel, inout float c[MAX_COMPONENTS], inout float a[FREE_COUNT * FREE_COUNT],
                 inout float gradient[FREE_COUNT])
{
    float mean[MAX_COMPONENTS];
    float deviation[MAX_COMPONENTS];
    read_mean(texel, mean);
    read_deviation(texel, deviation);
    float noise = texelFetch(u_noise, texel, 0).w;
    for (int u = 0; u < FREE_COUNT; u++) {
        FreeParameter free = free_at(u);
        if (deviation[free.at] > 0.0) {
            float curvature = noise * free.width * free.width / (deviation[free.at] * deviation[free.at]);
            a[u * FREE_COUNT + u] += curvature;
            gradient[u] += curvature * (c[free.at] - mean[free.at]) / free.width;
        }
    }
}
