// Over W×H texels: fitness of the prefit's estimates, for the acceptance test. A fit to fewer than MIN_SAMPLES
// samples fits their noise too and cannot judge another model: its fitness is UNFIT, which every model passes.

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
        if (samples >= MIN_SAMPLES) {
            float weights;
            o_fitness = fitness_of(t, estimate_at(texel), weights);
        }
    }
    return true;
}
