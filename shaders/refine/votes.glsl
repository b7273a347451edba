// Votes for a material: the number of texels, around and elsewhere on the surface, with similar searched numbers. Their
// worth: the next draw from a Pólya urn repeats a value in proportion to its draws so far (Blackwell & MacQueen 1973,
// Ferguson Distributions via Pólya Urn Schemes). Reads u_estimate of the neighbours, and the packing.
// materials.glsl is materials/shared.glsl or materials/none.glsl.

#include "common/estimate.glsl"
#include "common/packing.glsl"
#include "common/taps.glsl"
#include "free_parameters.glsl"
#include "materials.glsl"

// The 5×5 texels around: the first taps of common/taps.glsl.
#define VOTERS 24
// Two numbers are alike if they differ by less than this fraction of their range.
#define ALIKE 0.1
// An offer with this many times the votes of a texel's own material is refined, whatever its fitness. On rti_icon, near
// the mouth: 1 takes twice as many offers for a third fewer lone texels.
#define CROWD 1.5

float votes_for(ivec4 place, inout float c[12])
{
    float votes = votes_of_materials(c);
    for (int t = 0; t < VOTERS; t++) {
        ivec2 other = neighbour_at(place, tap_at(t));
        if (other.x < 0) {
            continue;
        }
        float theirs[12];
        material_to(estimate_at(other), theirs);
        float apart = 0.0;
        for (int u = 0; u < FREE_COUNT; u++) {
            FreeParameter free = free_at(u);
            float d = searched(u) ? (theirs[free.at] - c[free.at]) / (ALIKE * free.width) : 0.0;
            apart += d * d;
        }
        votes += exp(-0.5 * apart);
    }
    return votes;
}

// Degrees of freedom of the noise. weights: the sum over the samples, which have three channels each.
float freedom_of(float weights)
{
    return max(3.0 * weights - float(FREE_COUNT), 0.0);
}

// −2 log of the posterior of a material, up to a constant. The samples have Gaussian noise of unknown variance; the
// fitness estimates it.
float deviance_of(float freedom, float fitness, float votes)
{
    return freedom * log(fitness) - 2.0 * VOTES * log(1.0 + votes);
}
