// Support of a material: the number of texels, nearby and elsewhere on the surface, with similar searched numbers. It
// gives its prior probability by a Pólya urn: the next draw repeats a value in proportion to how often it was drawn
// before (Blackwell & MacQueen 1973, Ferguson Distributions via Pólya Urn Schemes). Reads u_estimate of neighbours and
// the packing. materials.glsl is materials/shared.glsl or materials/none.glsl.

#include "common/estimate.glsl"
#include "common/packing.glsl"
#include "common/taps.glsl"
#include "free_parameters.glsl"
#include "fitness/with_priors.glsl"
#include "materials.glsl"

// Neighbours that count: the 5×5 texels around, which are the first taps of common/taps.glsl.
#define SUPPORT_TAPS 24
// Standard deviation of the Gaussian kernel of two searched numbers, as a fraction of their range.
#define NEIGHBOUR_BANDWIDTH 0.1
// A proposal is refined, whatever its fitness, if it has this many times the support of the texel's own material. Near
// the mouth of rti_icon a ratio of 1 refines twice as many proposals and leaves a third fewer isolated texels.
#define SUPPORT_RATIO 1.5

float neighbour_support_of(ivec4 place, inout float c[MAX_COMPONENTS])
{
    float support = material_support_of(c);
    for (int t = 0; t < SUPPORT_TAPS; t++) {
        ivec2 other = neighbour_at(place, tap_at(t));
        if (other.x < 0) {
            continue;
        }
        float other_c[MAX_COMPONENTS];
        material_to(estimate_at(other), other_c);
        float squared_distance = 0.0;
        for (int u = 0; u < FREE_COUNT; u++) {
            FreeParameter free = free_at(u);
            float d = searched(u) ? (other_c[free.at] - c[free.at]) / (NEIGHBOUR_BANDWIDTH * free.width) : 0.0;
            squared_distance += d * d;
        }
        support += exp(-0.5 * squared_distance);
    }
    return support;
}

// Returns the degrees of freedom of the noise. weights: the sum of the samples' weights; a sample has three channels.
float degrees_of_freedom(float weights)
{
    return max(3.0 * weights - float(FREE_COUNT), 0.0);
}

// Returns −2 log posterior of a material, up to a constant (fitness/with_priors.glsl). fitness: with the model's
// priors.
float deviance_of(float freedom, float fitness, float support)
{
    return freedom * log(fitness + NOISE_FLOOR) - 2.0 * NEIGHBOUR_WEIGHT * log(1.0 + support);
}
