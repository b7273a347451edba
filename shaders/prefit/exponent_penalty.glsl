// Penalty of the prefit's refinement: a Gaussian prior on the exponent of n·l, N(1, EXPONENT_DEVIATION²). Few lights,
// or lights close together, cannot separate an exponent from a tilt of the normal: such texels stay near Lambert's law.
// EXPONENT_UNIT is ½ for each of three equal channels, in units of Cauchy's loss. Other losses have no such unit.

#include "free_parameters.glsl"

#if LOSS == LOSS_CAUCHY
#define EXPONENT_UNIT 1.5
#else
#define EXPONENT_UNIT 0.0
#endif

float exponent_precision()
{
    return EXPONENT_UNIT / (EXPONENT_DEVIATION * EXPONENT_DEVIATION);
}

float penalty_of(ivec2 texel, inout float c[MAX_COMPONENTS])
{
    float d = c[EXPONENT_COMPONENT] - 1.0;
    return exponent_precision() * d * d;
}

// JᵀWJ and JᵀWe are half the second and half the first derivative of the loss times δ², J per range.
void add_penalty(ivec2 texel, inout float c[MAX_COMPONENTS], inout float a[FREE_COUNT * FREE_COUNT],
                 inout float gradient[FREE_COUNT])
{
    float inverse_delta = inverse_delta_of(radiance_scale_at(texel));
    float precision_scaled = exponent_precision() / (inverse_delta * inverse_delta);
    for (int u = 0; u < FREE_COUNT; u++) {
        FreeParameter free = free_at(u);
        if (free.at == EXPONENT_COMPONENT) {
            a[u * FREE_COUNT + u] += precision_scaled * free.width * free.width;
            gradient[u] += precision_scaled * free.width * (c[free.at] - 1.0);
        }
    }
}
