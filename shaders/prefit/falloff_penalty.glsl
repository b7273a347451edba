// Penalty of the prefit's refinement: a Gaussian prior on the fall-off, N(1, FALLOFF_DEVIATION²). Few lights, or lights
// close together, cannot separate a fall-off from a tilt of the normal: such texels stay near Lambert's law.
// FALLOFF_UNIT is ½ for each of three equal channels, in units of Cauchy's loss. Other losses have no such unit.

#include "free_parameters.glsl"

#if LOSS == LOSS_CAUCHY
#define FALLOFF_UNIT 1.5
#else
#define FALLOFF_UNIT 0.0
#endif

float falloff_precision()
{
    return FALLOFF_UNIT / (FALLOFF_DEVIATION * FALLOFF_DEVIATION);
}

float penalty_of(ivec2 texel, inout float c[12])
{
    float d = c[FALLOFF_COMPONENT] - 1.0;
    return falloff_precision() * d * d;
}

// JᵀWJ and JᵀWe are half the second and half the first derivative of the loss times δ², J per range.
void add_penalty(ivec2 texel, inout float c[12], inout float a[FREE_COUNT * FREE_COUNT],
                 inout float gradient[FREE_COUNT])
{
    float inverse_delta = inverse_delta_of(radiance_scale_at(texel));
    float precision_scaled = falloff_precision() / (inverse_delta * inverse_delta);
    for (int u = 0; u < FREE_COUNT; u++) {
        FreeParameter free = free_at(u);
        if (free.at == FALLOFF_COMPONENT) {
            a[u * FREE_COUNT + u] += precision_scaled * free.width * free.width;
            gradient[u] += precision_scaled * free.width * (c[free.at] - 1.0);
        }
    }
}
