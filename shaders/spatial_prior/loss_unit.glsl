// Unit of losses. A sum of losses over n channels, divided by loss_unit(), is about n σ² for noise of variance σ². For
// l1 it is n b, with b the mean absolute error; a Laplace distribution has the variance 2 b².

#include "fitness/loss.glsl"

float loss_unit(ivec2 texel)
{
#if LOSS == LOSS_CAUCHY
    float inverse_delta = inverse_delta_of(radiance_scale_at(texel));
    return inverse_delta * inverse_delta;
#else
    return 1.0;
#endif
}

// Returns the factor from a deviance (−2 log likelihood) to losses over loss_unit(). noise: o_noise.w.
float deviance_unit(float noise)
{
#if LOSS == LOSS_L1
    return 0.5 * noise;
#else
    return noise;
#endif
}
