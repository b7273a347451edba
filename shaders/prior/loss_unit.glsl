// The unit of losses: divided by it, a sum of them over channels is about n σ² for noise of variance σ² (for l1, n times
// the mean absolute error b, of which the variance is 2 b² under the law that the loss stands for).

#include "fitness/loss.glsl"

float loss_unit(ivec2 texel)
{
#if FITNESS == FITNESS_ROBUST
    float scale = loss_scale(scale_at(texel));
    return scale * scale;
#else
    return 1.0;
#endif
}

// What a deviance, −2 log of a likelihood, is multiplied by to be counted in losses over loss_unit(); noise: o_noise.w.
float deviance_unit(float noise)
{
#if FITNESS == FITNESS_L1
    return 0.5 * noise;
#else
    return noise;
#endif
}
