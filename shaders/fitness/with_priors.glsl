// Fitness with the model's priors. For n samples with Gaussian noise of unknown variance, −2 log posterior is n log(F)
// + D, with fitness F and D the sum of −2 log prior. No fit to a photograph is better than NOISE_FLOOR, so the
// objective is n log(F + NOISE_FLOOR) + D. It orders materials like (F + NOISE_FLOOR) exp(D / n) − NOISE_FLOOR, which
// is F without priors. priors.glsl is generated (reflectance/glsl.py).

#include "material.glsl"
#include "priors.glsl"
#include "fitness/loss.glsl"

// Fitness of an error of 0.3 % of the mean irradiance/π, about one step of 8 bits. A robust fitness is in units of δ²,
// by default 3 % of it; the others are in radiance.
#if LOSS == LOSS_L1
#define NOISE_FLOOR (0.003 * u_mean_irradiance)
#elif LOSS == LOSS_L2
#define NOISE_FLOOR (9e-6 * u_mean_irradiance * u_mean_irradiance)
#else
#define NOISE_FLOOR 0.01
#endif
// Upper limit of D / n. It exceeds all realistic values and keeps exp() from overflow.
#define MAX_PRIOR_PER_SAMPLE 30.0

// Returns n from the sum of the samples' weights, three channels per sample. The result is at least 1.
float samples_of(float weights)
{
    return max(3.0 * weights, 1.0);
}

float with_priors(float fitness, float weights, Material s)
{
#if PRIORS > 0
    float c[MAX_COMPONENTS];
    material_to(s, c);
    float x = min(prior_deviance(c) / samples_of(weights), MAX_PRIOR_PER_SAMPLE);
    // exp(x) − 1, by its series near 0, where the difference cancels.
    float expm1_x = x < 1e-3 ? x + 0.5 * x * x : exp(x) - 1.0;
    return fitness + (fitness + NOISE_FLOOR) * expm1_x;
#else
    return fitness;
#endif
}
