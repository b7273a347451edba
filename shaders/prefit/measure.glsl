// Over W×H texels: how well the prefit's estimates explain a texel, on the acceptance test's terms. A fit to fewer than
// LEAST_SAMPLES meets whatever it is given, noise and all, so that it is no measure for another: UNFIT, which every model
// is under.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"

bool texel_kernel(ivec2 texel)
{
    o_fitness = UNFIT;
    if (state_at(texel) == TEXEL_SOLVED) {
        Texel t = observed_texel(texel);
        int told = 0;
        Observation o;
        EACH_OBSERVATION(t, o) {
            told++;
        }
        if (told >= LEAST_SAMPLES) {
            float weights;
            o_fitness = fitness_of(t, estimate_at(texel), weights);
        }
    }
    return true;
}
