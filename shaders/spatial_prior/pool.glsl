// Over W×H texels: pools colours and scalars of similar neighbours. A neighbour has the weight
//   s = exp(−½ Σ (x − y)² / (h² + σx² + σy²)), summed over all numbers, so that uncertain numbers hardly count.
// Mean and spread over the neighbours, each with its own precision, follow from a random-effects model (DerSimonian &
// Laird 1986, Meta-analysis in Clinical Trials), with s as multiplicity:
//   w = 1/σy²,  m₀ = Σ s w y / Σ s w,  t² = (Σ s w (y − m₀)² − (Σ s − 1)) / (Σ s w − Σ s w² / Σ s w),
//   w = 1/(σy² + t²),  m = Σ s w y / Σ s w,  with the deviation √(t² + 1 / Σ s w).
// Reads the estimates, their own deviations in u_own, the input of this round in u_mean and u_deviation (0: none), and
// the packing. Writes o_mean and o_deviation: in the LAST round m and its deviation; before, the input of the next
// round, where a number that the texel's own samples determine keeps its value and all others take m.

#include "common/estimate.glsl"
#include "common/frame.glsl"
#include "common/packing.glsl"
#include "components.glsl"
#include "common/taps.glsl"

// A number is not used if its deviation exceeds this fraction of its range: noise is not linear over such distances.
#define MAX_DEVIATION 0.25
// Smallest deviation, as a fraction of the range: the step of the finite differences from which it is computed.
#define FINEST_DEVIATION (1.0 / 1024.0)

struct Pooled {
    float weight[MAX_COMPONENTS];
    float sum[MAX_COMPONENTS];
    float squares[MAX_COMPONENTS];
    float weights_squared[MAX_COMPONENTS];
    float count[MAX_COMPONENTS];
};

// Returns s of the equation above.
float similarity(inout float x[MAX_COMPONENTS], inout float sigma_x[MAX_COMPONENTS], inout float y[MAX_COMPONENTS],
                 inout float sigma_y[MAX_COMPONENTS])
{
    float squared_distance = 0.0;
    for (int i = 0; i < COMPONENTS; i++) {
        float width;
        int kind;
        component_at(i, width, kind);
        if (kind == COMPONENT_OTHER) {
            continue;
        }
        float h = kind == COMPONENT_COLOR ? COLOR_BANDWIDTH * max(abs(x[i]), abs(y[i])) + FINEST_DEVIATION * width
                                          : BANDWIDTH * width;
        float d = x[i] - y[i];
        squared_distance += d * d / (h * h + sigma_x[i] * sigma_x[i] + sigma_y[i] * sigma_y[i]);
    }
    return exp(-0.5 * squared_distance);
}

// Computes the sums over the neighbours. t2: t² of each number.
void pool(ivec2 texel, inout float x[MAX_COMPONENTS], inout float sigma_x[MAX_COMPONENTS],
          inout float t2[MAX_COMPONENTS], out Pooled p)
{
    for (int i = 0; i < MAX_COMPONENTS; i++) {
        p.weight[i] = 0.0;
        p.sum[i] = 0.0;
        p.squares[i] = 0.0;
        p.weights_squared[i] = 0.0;
        p.count[i] = 0.0;
    }
    ivec4 place = surface_place_of(texel);
    for (int t = 0; t < TAPS; t++) {
        ivec2 other = neighbour_at(place, tap_at(t));
        if (other.x < 0) {
            continue;
        }
        float y[MAX_COMPONENTS];
        float sigma_y[MAX_COMPONENTS];
        read_mean(other, y);
        read_deviation(other, sigma_y);
        float s = similarity(x, sigma_x, y, sigma_y);
        for (int i = 0; i < COMPONENTS; i++) {
            float width;
            int kind;
            component_at(i, width, kind);
            if (kind == COMPONENT_OTHER || !(sigma_y[i] < MAX_DEVIATION * width)) {
                continue;
            }
            float sigma = max(sigma_y[i], FINEST_DEVIATION * width);
            float w = 1.0 / (sigma * sigma + t2[i]);
            // Relative to the texel's own number: keeps precision in the difference of squares.
            float d = y[i] - x[i];
            p.weight[i] += s * w;
            p.sum[i] += s * w * d;
            p.squares[i] += s * w * d * d;
            p.weights_squared[i] += s * w * w;
            p.count[i] += s;
        }
    }
}

bool texel_kernel(ivec2 texel)
{
    float x[MAX_COMPONENTS];
    float sigma_x[MAX_COMPONENTS];
    float mean[MAX_COMPONENTS];
    float deviation[MAX_COMPONENTS];
    material_to(estimate_at(texel), x);
    read_own(texel, sigma_x);
    read_mean(texel, mean);
    read_deviation(texel, deviation);
    if (state_at(texel) == TEXEL_SOLVED) {
        float t2[MAX_COMPONENTS];
        for (int i = 0; i < MAX_COMPONENTS; i++) {
            t2[i] = 0.0;
        }
        Pooled p;
        pool(texel, x, sigma_x, t2, p);
        for (int i = 0; i < COMPONENTS; i++) {
            float width;
            int kind;
            component_at(i, width, kind);
            float min_t2 = MIN_DEVIATION * width * MIN_DEVIATION * width;
            float denominator = p.weight[i] > 0.0 ? p.weight[i] - p.weights_squared[i] / p.weight[i] : 0.0;
            float q = p.weight[i] > 0.0 ? p.squares[i] - p.sum[i] * p.sum[i] / p.weight[i] : 0.0;
            t2[i] = max(min_t2, denominator > 0.0 ? (q - (p.count[i] - 1.0)) / denominator : 0.0);
        }
        pool(texel, x, sigma_x, t2, p);
        for (int i = 0; i < COMPONENTS; i++) {
            float width;
            int kind;
            component_at(i, width, kind);
#ifdef LAST
            deviation[i] = 0.0;
#endif
            // Below 1e-6 of a neighbour, the weights are tails of exp().
            if (kind != COMPONENT_OTHER && p.count[i] > 1e-6) {
#ifndef LAST
                if (sigma_x[i] < MAX_DEVIATION * width) {
                    continue;
                }
#endif
                mean[i] = x[i] + p.sum[i] / p.weight[i];
                deviation[i] = sqrt(t2[i] + 1.0 / p.weight[i]);
            }
        }
    }
    write_mean(mean);
    write_deviation(deviation);
    return true;
}
