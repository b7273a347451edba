// Over W×H texels: acceptance test. The texel keeps its former estimate, that of the prefit with the rest fitted to its
// normal, or of a later phase, if the refined estimate fits much worse than the prefit's model did: such a refinement
// has turned the normal to compensate errors of its model. All fitnesses are those of the prefit, on grey samples.
// Reads the estimates before the refinement, u_work (after it) and u_prefit_fitness. Writes the estimates.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"

bool texel_kernel(ivec2 texel)
{
    float c[MAX_COMPONENTS];
    read_work(texel, c);
    if (state_at(texel) == TEXEL_SOLVED) {
        float weights;
        float fitness = fitness_of(observed_texel(texel), material_from(c), weights);
        if (fitness > ACCEPTANCE_RATIO * texelFetch(u_prefit_fitness, texel, 0).x + ACCEPTANCE_FLOOR) {
            read_estimate(texel, c);
        }
    }
    write_estimate(c);
    return true;
}
