// The fitness of a material with its model's priors. For n samples with Gaussian noise of unknown variance −2 log of the
// posterior is n log(F) + D, with F the fitness and D the priors' part. No fit to a photograph is better than NOISE_FLOOR,
// so it is n log(F + NOISE_FLOOR) + D, which orders materials like (F + NOISE_FLOOR) exp(D / n) − NOISE_FLOOR: F without
// priors. priors.glsl is generated (reflectance/glsl.py).

#include "material.glsl"
#include "priors.glsl"

// In squares of δ: 0.3 % of a texel's scale, about a step of eight bits.
#define NOISE_FLOOR 0.01
// D / n far beyond any preference, without overflow.
#define MOST_BELIEF 30.0

// n of samples with this sum of weights, three channels each; at least that of one sample.
float samples_of(float weights)
{
    return max(3.0 * weights, 1.0);
}

float with_priors(float fitness, float weights, Material s)
{
#if PRIORS > 0
    float c[12];
    material_to(s, c);
    float x = min(prior_deviance(c) / samples_of(weights), MOST_BELIEF);
    // exp(x) − 1, whose digits near 0 would be lost.
    float more = x < 1e-3 ? x + 0.5 * x * x : exp(x) - 1.0;
    return fitness + (fitness + NOISE_FLOOR) * more;
#else
    return fitness;
#endif
}
