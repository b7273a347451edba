// Over W×H texels: accepts the refined estimate unless its model fits the texel much worse than the prefit's model did. In
// that case the refinement has turned the normal to compensate for the model's errors, and the texel keeps its former
// estimate: the prefit's normal, and the rest fitted to it. Reads the estimates before the refinement, u_work (after it)
// and u_prefit_fitness. All fitnesses are those of the prefit: on grey samples.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"

bool texel_kernel(ivec2 texel)
{
    float c[12];
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
