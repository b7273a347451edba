// Over W×H texels: the fitness of the prefit's estimates for the acceptance test. A fit to fewer than LEAST_SAMPLES fits the
// noise too, and is no measure for another model: its fitness is UNFIT, which every model is below.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"

bool texel_kernel(ivec2 texel)
{
    o_fitness = UNFIT;
    if (state_at(texel) == TEXEL_SOLVED) {
        Texel t = observed_texel(texel);
        int samples = 0;
        Observation o;
        EACH_OBSERVATION(t, o) {
            samples++;
        }
        if (samples >= LEAST_SAMPLES) {
            float weights;
            o_fitness = fitness_of(t, estimate_at(texel), weights);
        }
    }
    return true;
}
