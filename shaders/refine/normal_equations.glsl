// Step of Levenberg and Marquardt with bounds on the parameters: damped normal equations.
// Marquardt 1963, An Algorithm for Least-Squares Estimation of Nonlinear Parameters. His scaling makes λ relative to
// the diagonal: a is JᵀWJ scaled to a unit diagonal (upper triangle), gradient is JᵀWe scaled likewise.

// After hundreds of samples in float32, a pivot below 2⁻²⁰ of the unit diagonal is rounding: its parameter stays.
#define PIVOT (1.0 / 1048576.0)

// Solves (A + λ) y = −gradient for the parameters that are not at a bound; the others keep their y.
// Cholesky: A + λ = L D Lᵀ.
void solve_damped(inout float a[FREE_COUNT * FREE_COUNT], inout float gradient[FREE_COUNT], float lambda,
                  inout bool at_bound[FREE_COUNT], inout float y[FREE_COUNT])
{
    float l[FREE_COUNT * FREE_COUNT];
    float pivot[FREE_COUNT];
    float rhs[FREE_COUNT];
    bool dropped[FREE_COUNT];
    for (int i = 0; i < FREE_COUNT; i++) {
        rhs[i] = -gradient[i];
        for (int k = 0; k < FREE_COUNT; k++) {
            if (at_bound[k] && k != i) {
                rhs[i] -= a[min(i, k) * FREE_COUNT + max(i, k)] * y[k];
            }
        }
    }
    for (int j = 0; j < FREE_COUNT; j++) {
        float d = 1.0 + lambda;
        for (int k = 0; k < j; k++) {
            d -= dropped[k] ? 0.0 : l[j * FREE_COUNT + k] * l[j * FREE_COUNT + k] * pivot[k];
        }
        dropped[j] = at_bound[j] || !(d > PIVOT);
        pivot[j] = dropped[j] ? 1.0 : d;
        for (int i = j + 1; i < FREE_COUNT; i++) {
            float sum = a[j * FREE_COUNT + i];
            for (int k = 0; k < j; k++) {
                sum -= dropped[k] ? 0.0 : l[i * FREE_COUNT + k] * l[j * FREE_COUNT + k] * pivot[k];
            }
            l[i * FREE_COUNT + j] = dropped[j] ? 0.0 : sum / pivot[j];
        }
    }
    for (int i = 0; i < FREE_COUNT; i++) {
        for (int k = 0; k < i; k++) {
            rhs[i] -= dropped[k] ? 0.0 : l[i * FREE_COUNT + k] * rhs[k];
        }
    }
    for (int i = FREE_COUNT - 1; i >= 0; i--) {
        float sum = rhs[i] / pivot[i];
        for (int k = i + 1; k < FREE_COUNT; k++) {
            sum -= dropped[k] ? 0.0 : l[k * FREE_COUNT + i] * y[k];
        }
        if (!at_bound[i]) {
            y[i] = dropped[i] ? 0.0 : sum;
        }
    }
}

// Iterations of the active set: the parameters at a bound. After the last one, steps are clamped to the bounds.
#define BOX_ROUNDS 3

// Computes the bounded step delta. lower and upper bound each parameter's step. delta, lower and upper are fractions of
// the ranges. A parameter whose step exceeds a bound is set to it, and the others are solved again.
void boxed_step(inout float a[FREE_COUNT * FREE_COUNT], inout float gradient[FREE_COUNT], inout float norm[FREE_COUNT],
                float lambda, inout float lower[FREE_COUNT], inout float upper[FREE_COUNT], out float delta[FREE_COUNT])
{
    bool at_bound[FREE_COUNT];
    float y[FREE_COUNT];
    for (int i = 0; i < FREE_COUNT; i++) {
        // At a bound and would cross it. A parameter on which the render does not depend stays like one at a bound.
        at_bound[i] = norm[i] == 0.0 || (gradient[i] > 0.0 && lower[i] >= 0.0)
                      || (gradient[i] < 0.0 && upper[i] <= 0.0);
        y[i] = 0.0;
    }
    for (int round = 0; round < BOX_ROUNDS; round++) {
        solve_damped(a, gradient, lambda, at_bound, y);
        bool inside = true;
        for (int i = 0; i < FREE_COUNT; i++) {
            float unscaled = norm[i] > 0.0 ? y[i] / norm[i] : 0.0;
            if (!at_bound[i] && (unscaled < lower[i] || unscaled > upper[i])) {
                y[i] = norm[i] * clamp(unscaled, lower[i], upper[i]);
                at_bound[i] = true;
                inside = false;
            }
        }
        if (inside) {
            break;
        }
    }
    for (int i = 0; i < FREE_COUNT; i++) {
        float unscaled = norm[i] > 0.0 ? y[i] / norm[i] : 0.0;
        // NaN becomes a step of 0.
        delta[i] = abs(unscaled) <= 1e6 ? clamp(unscaled, lower[i], upper[i]) : 0.0;
    }
}
