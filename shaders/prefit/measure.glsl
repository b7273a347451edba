// Over W×H texels: how well the prefit's estimates explain a texel, on the acceptance test's terms. A fit to fewer than
// LEAST_SAMPLES meets whatever it is given, noise and all, so that it is no measure for another: UNFIT, which every model
// is under.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"

bool texel_kernel(ivec2 texel)
{
    o_fitness = UNFIT;
    if (state_at(texel) == TEXEL_SOLVED) {
        Frame f = frame_at(texel);
        int told = 0;
        for (int k = 0; k < u_observations; k++) {
            Observation o;
            told += observe(texel, f, k, o) ? 1 : 0;
        }
        if (told >= LEAST_SAMPLES) {
            float weights;
            o_fitness = fitness_of(texel, f, estimate_at(texel), weights);
        }
    }
    return true;
}
