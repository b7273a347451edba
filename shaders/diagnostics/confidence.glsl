// Over W×H texels: standard deviations of the free parameters, from (JᵀJ)⁻¹ over all of them jointly and the residual.
// Reads the estimates, the geometry, the sample stack and the observation table; with NOISE_GIVEN the noise's variance
// in u_noise.z. Writes o_deviation, packed like the estimates, in the parameters' units. The first component of a
// normal holds the root of the sum of its two tangent variances, in radians; the other two hold 0.

#include "common/estimate.glsl"
#include "model.glsl"
#include "fitness/error_scale.glsl"
#include "fitness/with_priors.glsl"
#include "fitness/differences.glsl"
#include "diagnostics/freedom.glsl"
#include "diagnostics/sweep.glsl"

// The normal matrix squares the condition number of J. After hundreds of samples in float32, a remainder below 2⁻¹⁸ of
// a diagonal entry is rounding. Against float64, on random two-lobe and principled materials, at noise of 1e-3 of
// white, σ is right to 1e-3 in the median, too large in 0.5 % (at 1e-4: up to 5 %), too small by a tenth in under 2 %.
#define SINGULAR (1.0 / 262144.0)

// Limit of the residual in hollows, as a fraction of the radiance. Above it most light comes from other surfaces, and
// the texel counts as unknown. On rendered captures the normals of such texels are off by 60° (a goblet of brass) and
// 35° (a concave mix of materials) in the median. Without them the mean error is 5.6 and 6.6°, with them 19.6 and 9.3°.
#define UNEXPLAINED_LIMIT 0.1

// The same limit where the indirect light was estimated from colour alone and subtracted: its remainder adds to the
// residual. Of a goblet and a bowl of gilded fruits 17 and 50 % of the texels are above it, with normals off by 6 and
// 35° in the median. The others are off by 3.7 and 3.4° in the mean.
#define UNEXPLAINED_LIMIT_SEPARATED 0.2

// Returns two steps for a derivative of second order: one to each side or, at an end of the range, both inward. The
// relative error of the stencil is (2⁻¹⁰)² f‴ / (6 f′), below 1 % in a lobe of m = 0.05.
vec2 steps_of(inout float c[MAX_COMPONENTS], int u)
{
    FreeParameter free = free_at(u);
    if (is_normal(u)) {
        return vec2(-STEP, STEP);
    }
    float x = (c[free.at] - free.low) / free.width;
    return x < STEP ? vec2(STEP, 2.0 * STEP) : x > 1.0 - STEP ? vec2(-STEP, -2.0 * STEP) : vec2(-STEP, STEP);
}

// Sums a = JᵀJ (upper triangle; J per range), the errors, and the squared radiances in energy. Clipped channels whose
// lower bound is satisfied do not count. unexplained: sum of absolute errors over sum of absolute radiances.
void accumulate(
    ivec2 texel, inout float c[MAX_COMPONENTS], out float a[FREE_COUNT * FREE_COUNT], out ErrorSums sums,
    out float energy, out float unexplained)
{
    for (int i = 0; i < FREE_COUNT * FREE_COUNT; i++) {
        a[i] = 0.0;
    }
    clear_errors(sums);
    energy = 0.0;
    float absolute_error = 0.0;
    float absolute_radiance = 0.0;
    vec2 steps[FREE_COUNT];
    for (int u = 0; u < FREE_COUNT; u++) {
        steps[u] = steps_of(c, u);
    }
    Texel t = observed_texel(texel);
    Material s = material_from(c);
    Observation o;
    EACH_OBSERVATION(t, o) {
        vec3 rho = reflectance(s, o.l, o.v);
        vec3 render = o.intensity * rho;
        vec3 error = error_of(o, rho);
        float scale = error_scale(t, o);
        vec3 counted = o.weight * active_channels(o, error);
        vec3 weight = scale * scale * counted;
        add_error(sums, error, weight, counted);
        energy += dot(weight, render * render);
        absolute_error += dot(counted, abs(error));
        absolute_radiance += dot(counted, abs(o.radiance));
        vec3 j[FREE_COUNT];
        for (int u = 0; u < FREE_COUNT; u++) {
            vec2 delta = steps[u];
            vec3 first = o.intensity * reflectance(moved(c, u, delta.x), o.l, o.v) - render;
            vec3 second = o.intensity * reflectance(moved(c, u, delta.y), o.l, o.v) - render;
            // Derivative at 0 of the parabola through the three values.
            j[u] = (first * (delta.y / delta.x) - second * (delta.x / delta.y)) / (delta.y - delta.x);
        }
        for (int row = 0; row < FREE_COUNT; row++) {
            vec3 weighted = weight * j[row];
            for (int column = row; column < FREE_COUNT; column++) {
                a[row * FREE_COUNT + column] += dot(weighted, j[column]);
            }
        }
    }
    unexplained = absolute_radiance > 0.0 ? absolute_error / absolute_radiance : 0.0;
}

// Adds the precision of the model's priors to JᵀJ, in units of the samples' precision 1 / variance.
void add_priors(inout float c[MAX_COMPONENTS], float variance, inout float a[FREE_COUNT * FREE_COUNT])
{
#if PRIORS > 0
    for (int u = 0; u < FREE_COUNT; u++) {
        FreeParameter free = free_at(u);
        a[u * FREE_COUNT + u] += max(variance, 0.0) * free.width * free.width * prior_precision(c, free.at);
    }
#endif
}

// Computes the deviations of the free parameters from a = JᵀJ, as fractions of their ranges. An undetermined parameter
// has the deviation 1. It raises the deviations of the parameters that are correlated with it.
void deviations_from(inout float a[FREE_COUNT * FREE_COUNT], float variance, float energy,
                     out float deviation[FREE_COUNT])
{
    // Scales a to a unit diagonal. A pivot is then the remainder of 1.
    float norm[FREE_COUNT];
    bool swept[FREE_COUNT];
    for (int i = 0; i < FREE_COUNT; i++) {
        norm[i] = sqrt(a[i * FREE_COUNT + i]);
        swept[i] = false;
    }
    for (int i = 0; i < FREE_COUNT; i++) {
        for (int m = i; m < FREE_COUNT; m++) {
            float scale = norm[i] * norm[m];
            a[i * FREE_COUNT + m] = scale > 0.0 ? a[i * FREE_COUNT + m] / scale : 0.0;
            a[m * FREE_COUNT + i] = a[i * FREE_COUNT + m];
        }
    }
    // A parameter is undetermined if its whole range changes the render by less than rounding or noise.
    float negligible = max(DIFFERENCE_ROUNDING * DIFFERENCE_ROUNDING * energy, variance);
    for (int round = 0; round < FREE_COUNT; round++) {
        // Eliminates the parameter that changes the render most. So the undetermined ones matter least.
        int chosen = -1;
        float largest = negligible;
        for (int i = 0; i < FREE_COUNT; i++) {
            float remainder = a[i * FREE_COUNT + i];
            if (!swept[i] && remainder > SINGULAR && remainder * norm[i] * norm[i] > largest) {
                chosen = i;
                largest = remainder * norm[i] * norm[i];
            }
        }
        if (chosen < 0) {
            break;
        }
        sweep(a, chosen);
        swept[chosen] = true;
    }
    for (int i = 0; i < FREE_COUNT; i++) {
        deviation[i] = 1.0;
        if (swept[i]) {
            float squared = -a[i * FREE_COUNT + i] * variance;
            for (int m = 0; m < FREE_COUNT; m++) {
                float coupled = swept[m] ? 0.0 : a[i * FREE_COUNT + m] * norm[m];
                squared += coupled * coupled;
            }
            squared /= norm[i] * norm[i];
            // NaN counts as undetermined.
            deviation[i] = squared < 1.0 ? sqrt(squared) : 1.0;
        }
    }
}

// Returns the variance of the noise, negative with too few samples.
float variance_of(ivec2 texel, ErrorSums sums)
{
#ifdef NOISE_GIVEN
    return texelFetch(u_noise, texel, 0).z;
#else
    float freedom = degrees_of_freedom(sums);
    float min_variance = 0.0;
#if LOSS == LOSS_CAUCHY
    float inverse_delta = inverse_delta_of(radiance_scale_at(texel));
    min_variance = NOISE_FLOOR / (inverse_delta * inverse_delta);
#endif
    return freedom > 0.0 ? redundancy_of(sums) * sums.squares / freedom + min_variance : -1.0;
#endif
}

bool texel_kernel(ivec2 texel)
{
    float sigma[MAX_COMPONENTS];
    for (int i = 0; i < MAX_COMPONENTS; i++) {
        sigma[i] = 0.0;
    }
    if (state_at(texel) == TEXEL_SOLVED) {
        float c[MAX_COMPONENTS];
        material_to(estimate_at(texel), c);
        float a[FREE_COUNT * FREE_COUNT];
        ErrorSums sums;
        float energy;
        float unexplained;
        accumulate(texel, c, a, sums, energy, unexplained);
        float deviation[FREE_COUNT];
        float variance = variance_of(texel, sums);
#ifndef NOISE_GIVEN
        add_priors(c, variance, a);
        float limit = separated_at(texel) ? UNEXPLAINED_LIMIT_SEPARATED : UNEXPLAINED_LIMIT;
        if (shadow_at(texel) > 0.0 && unexplained > limit) {
            variance = -1.0;
        }
#endif
        if (variance >= 0.0) {
            deviations_from(a, variance, energy, deviation);
        }
        for (int u = 0; u < FREE_COUNT; u++) {
            FreeParameter free = free_at(u);
            float in_units = free.width * (variance >= 0.0 ? deviation[u] : 1.0);
            // The two numbers of a normal share a component: their variances add up, clamped to its range.
            sigma[free.at] = min(free.width, length(vec2(sigma[free.at], in_units)));
        }
    }
    write_deviation(sigma);
    return true;
}
