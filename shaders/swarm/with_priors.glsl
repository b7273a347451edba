// The fitness of a material with what its model believes beforehand. For n samples of Gaussian noise of unknown variance
// −2 log of the posterior is n log(fitness) + D, D that of the priors: a fitness F counts as F exp(D / n).
// priors.glsl is generated (reflectance/glsl.py).

#include "material.glsl"
#include "priors.glsl"

// Far beyond what is ever preferred, and no overflow.
#define MOST_BELIEF 30.0

// n of samples that weigh so much together, of three channels each; a single one where there are none.
float samples_of(float weights)
{
    return max(3.0 * weights, 1.0);
}

float with_priors(float fitness, float weights, Material s)
{
#if PRIORS > 0
    return fitness * exp(min(prior_deviance(s) / samples_of(weights), MOST_BELIEF));
#else
    return fitness;
#endif
}
