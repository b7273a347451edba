// Pass A of the synchronous swarm, over W×H texels: evaluates every particle at its new position.
// Reads the swarm atlas and u_mean, the global bests with their linear weights, the estimates, the geometry with its
// packing, the sample stack and the observation table.
// Writes o_fitness, one number per particle, and o_linear, the linear weights of the best particle. It does not write
// the new positions: a pass has at most six outputs, and the commit passes can compute them again cheaply. With START
// it evaluates the initial positions.
//
// CHUNK particles share one read of an observation. There are two loops: linear weights, then residual. In float32 the
// residual does not follow from the sums of the first loop: Σc² − bᵀA⁻¹b stalls at an error of 5 % in roughness.

#include "fitness/fitness.glsl"
#include "swarm/synchronous/incumbent.glsl"
#include "fitness/linear.glsl"
#include "swarm/synchronous/moved.glsl"

bool texel_kernel(ivec2 texel)
{
    float fitness[MAX_PARTICLES];
    for (int i = 0; i < MAX_PARTICLES; i++) {
        fitness[i] = UNFIT;
    }
#if LINEAR_BLOCKS > 0
    Linear best_linear;
    clear_linear(best_linear);
    float best_fitness = 2.0 * UNFIT;
#endif
    if (state_at(texel) == TEXEL_SOLVED && texelFetch(u_best_fitness, texel, 0).x > u_threshold) {
        Texel t = observed_texel(texel);
        float inverse_delta = inverse_delta_of(t.radiance_scale);
        float albedo_limit = albedo_limit_of(t.radiance_scale);
        Material estimate = estimate_at(texel);
#if LINEAR_BLOCKS > 0
        Material incumbent = material_of_best(texel);
#endif
        for (int first = 0; first < PARTICLES; first += CHUNK) {
            Material s[CHUNK];
            float sum[CHUNK];
#if LINEAR_BLOCKS > 0
            Equations equations[CHUNK];
            Linear linear[CHUNK];
#endif
            for (int p = 0; p < CHUNK; p++) {
                float x[MAX_DIMENSIONS];
                float v[MAX_DIMENSIONS];
                moved_particle(texel, t.frame, min(first + p, PARTICLES - 1), x, v);
                s[p] = estimate;
                decode(x, albedo_limit, s[p]);
                sum[p] = 0.0;
#if LINEAR_BLOCKS > 0
                clear_equations(equations[p]);
                clear_linear(linear[p]);
#endif
            }
            Observation o;
            float weights = 0.0;
#if LINEAR_BLOCKS > 0
            EACH_OBSERVATION(t, o) {
                vec3 error = error_of(o, reflectance(incumbent, o.l, o.v));
                vec3 weight = reweighted(t, o, error, error_scale(t, o));
                for (int p = 0; p < CHUNK; p++) {
                    add_observation(equations[p], s[p], o, weight);
                }
            }
            for (int p = 0; p < CHUNK; p++) {
                solve_linear(equations[p], linear[p]);
                linear_to(linear[p], s[p]);
            }
#endif
            EACH_OBSERVATION(t, o) {
                float scale_over_delta = inverse_delta * error_scale(t, o);
                for (int p = 0; p < CHUNK; p++) {
                    vec3 error = error_of(o, reflectance(s[p], o.l, o.v));
                    sum[p] += weighted_loss(o, error, scale_over_delta);
                }
                weights += o.weight;
            }
            for (int p = 0; p < CHUNK && first + p < PARTICLES; p++) {
                float mean = with_priors(sum[p] / (3.0 * weights), weights, s[p]);
                // NaN becomes UNFIT: it must never become a best.
                float fitness_of_particle = weights > 0.0 && mean < UNFIT ? mean : UNFIT;
                fitness[first + p] = fitness_of_particle;
#if LINEAR_BLOCKS > 0
                if (fitness_of_particle < best_fitness) {
                    best_fitness = fitness_of_particle;
                    best_linear = linear[p];
                }
#endif
            }
        }
    }
    write_fitness(fitness);
#if LINEAR_BLOCKS > 0
    float w[MAX_WEIGHTS];
    numbers_of(best_linear, w);
    write_linear(w);
#endif
    return true;
}
