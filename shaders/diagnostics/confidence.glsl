// Over W×H texels: the standard deviation of every free parameter, from (JᵀJ)⁻¹ over all of them jointly and the residual.
// Reads the estimates, the geometry, the sample stack and the observation table; with NOISE_GIVEN the variance of the noise
// in u_noise.z. Writes o_deviation, packed like the estimates, in the parameters' units; the first component of a normal
// holds the root of its two tangent variances, in radians, the others 0.

#include "common/estimate.glsl"
#include "model.glsl"
#include "fitness/relative_error.glsl"
#include "fitness/with_priors.glsl"
#include "fitness/differences.glsl"
#include "diagnostics/freedom.glsl"
#include "diagnostics/sweep.glsl"

// The normal matrix squares the condition of J: after hundreds of samples in float32, a remainder below 2⁻¹⁸ of a diagonal
// is rounding. Against float64, on random two-lobe and principled materials: at noise of 1e-3
// of white σ is right to 1e-3 in the median and 1 in 200 is too large; at 1e-4 up to 1 in 20 is. Too small by a tenth
// are fewer than 1 in 50.
#define SINGULAR (1.0 / 262144.0)

// Of the light that reaches a texel in hollows: where the estimates leave more of it, other surfaces throw most of it, and
// what was found is not the material. On rendered captures the normals of such texels are off by 60° (a goblet of brass)
// and 35° (a concave mix of materials) in the median; those of the others by 5.6 and 6.6° in the mean, not 19.6 and 9.3.
#define LEAST_UNEXPLAINED 0.1

// The same, where the colour of light alone told of its indirect part, which was taken off: what is left of that counts as
// unexplained, too. Of a goblet and a bowl of gilded fruits 17 and 50 % are unknown, off by 6 and 35° in the median; the
// others by 3.7 and 3.4° in the mean.
#define LEAST_UNEXPLAINED_SEPARATED 0.2

// Two steps for a derivative of second order: to both sides, or, at an end of the range, both inward. The stencil's own
// error is (2⁻¹⁰ f‴ / f′)² / 6, under 1 % in a lobe of m = 0.05.
vec2 steps_of(inout float c[12], int u)
{
    FreeParameter free = free_at(u);
    if (is_normal(u)) {
        return vec2(-STEP, STEP);
    }
    float x = (c[free.at] - free.low) / free.width;
    return x < STEP ? vec2(STEP, 2.0 * STEP) : x > 1.0 - STEP ? vec2(-STEP, -2.0 * STEP) : vec2(-STEP, STEP);
}

// Sums JᵀJ (upper triangle; J per range), the errors and the squared radiances. A bound that is met adds nothing.
// unexplained: the errors as a part of the light.
void accumulate(
    ivec2 texel, inout float c[12], out float a[FREE_COUNT * FREE_COUNT], out ErrorSums sums, out float energy,
    out float unexplained)
{
    for (int i = 0; i < FREE_COUNT * FREE_COUNT; i++) {
        a[i] = 0.0;
    }
    clear_errors(sums);
    energy = 0.0;
    float off = 0.0;
    float light = 0.0;
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
        float relative = relative_error(t, o);
        vec3 counted = o.weight * active_channels(o, error);
        vec3 weight = relative * relative * counted;
        add_error(sums, error, weight, counted);
        energy += dot(weight, render * render);
        off += dot(counted, abs(error));
        light += dot(counted, abs(o.radiance));
        vec3 j[FREE_COUNT];
        for (int u = 0; u < FREE_COUNT; u++) {
            vec2 by = steps[u];
            vec3 first = o.intensity * reflectance(moved(c, u, by.x), o.l, o.v) - render;
            vec3 second = o.intensity * reflectance(moved(c, u, by.y), o.l, o.v) - render;
            // The slope at 0 of the parabola through the three.
            j[u] = (first * (by.y / by.x) - second * (by.x / by.y)) / (by.y - by.x);
        }
        for (int row = 0; row < FREE_COUNT; row++) {
            vec3 weighted = weight * j[row];
            for (int column = row; column < FREE_COUNT; column++) {
                a[row * FREE_COUNT + column] += dot(weighted, j[column]);
            }
        }
    }
    unexplained = light > 0.0 ? off / light : 0.0;
}

// Adds the precision of the model's priors, in samples of this variance.
void add_priors(inout float c[12], float variance, inout float a[FREE_COUNT * FREE_COUNT])
{
#if PRIORS > 0
    for (int u = 0; u < FREE_COUNT; u++) {
        FreeParameter free = free_at(u);
        a[u * FREE_COUNT + u] += max(variance, 0.0) * free.width * free.width * prior_precision(c, free.at);
    }
#endif
}

// Turns JᵀJ into the deviations of the free parameters, as fractions of their ranges. An undetermined one has the deviation
// 1 and passes it on to those that can be traded for it.
void deviations_from(inout float a[FREE_COUNT * FREE_COUNT], float variance, float energy, out float deviation[FREE_COUNT])
{
    // Unit diagonal first: the pivots are then what is left of 1.
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
    float nothing = max(DIFFERENCE_ROUNDING * DIFFERENCE_ROUNDING * energy, variance);
    for (int round = 0; round < FREE_COUNT; round++) {
        // The parameter that changes the render most goes first: those that remain undetermined matter least.
        int chosen = -1;
        float most = nothing;
        for (int i = 0; i < FREE_COUNT; i++) {
            float left = a[i * FREE_COUNT + i];
            if (!swept[i] && left > SINGULAR && left * norm[i] * norm[i] > most) {
                chosen = i;
                most = left * norm[i] * norm[i];
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
                float traded = swept[m] ? 0.0 : a[i * FREE_COUNT + m] * norm[m];
                squared += traded * traded;
            }
            squared /= norm[i] * norm[i];
            // NaN is undetermined too.
            deviation[i] = squared < 1.0 ? sqrt(squared) : 1.0;
        }
    }
}

// The variance of the noise, below 0 with too few samples.
float variance_of(ivec2 texel, ErrorSums sums)
{
#ifdef NOISE_GIVEN
    return texelFetch(u_noise, texel, 0).z;
#else
    float freedom = freedom_of(sums);
    float least = 0.0;
#if FITNESS == FITNESS_ROBUST
    least = NOISE_FLOOR / (loss_scale(scale_at(texel)) * loss_scale(scale_at(texel)));
#endif
    return freedom > 0.0 ? alike_of(sums) * sums.errors / freedom + least : -1.0;
#endif
}

bool texel_kernel(ivec2 texel)
{
    float sigma[12];
    for (int i = 0; i < 12; i++) {
        sigma[i] = 0.0;
    }
    if (state_at(texel) == TEXEL_SOLVED) {
        float c[12];
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
        float shadow = shadow_at(texel);
        bool separated = shadow < 1.5 * SEPARATED_SHADOW;
        if (shadow > 0.0 && unexplained > (separated ? LEAST_UNEXPLAINED_SEPARATED : LEAST_UNEXPLAINED)) {
            variance = -1.0;
        }
#endif
        if (variance >= 0.0) {
            deviations_from(a, variance, energy, deviation);
        }
        for (int u = 0; u < FREE_COUNT; u++) {
            FreeParameter free = free_at(u);
            float own = free.width * (variance >= 0.0 ? deviation[u] : 1.0);
            // The normal's two numbers share a component: their variances add up, to its range at most.
            sigma[free.at] = min(free.width, length(vec2(sigma[free.at], own)));
        }
    }
    write_deviation(sigma);
    return true;
}
