// Damped normal equations inside a box: the step of Levenberg and Marquardt.
// Marquardt 1963, An Algorithm for Least-Squares Estimation of Nonlinear Parameters; its scaling makes λ relative to the
// diagonal. a holds JᵀWJ, of unit diagonal (upper triangle), slope JᵀWe likewise scaled.

// After hundreds of samples in float32, a pivot below 2⁻²⁰ of the unit diagonal is rounding: its parameter stays.
#define PIVOT (1.0 / 1048576.0)

// Solves (A + λ) y = −slope for the parameters that are free to move; held ones keep their y. Cholesky: A + λ = L D Lᵀ.
void solve_damped(inout float a[FREE_COUNT * FREE_COUNT], inout float slope[FREE_COUNT], float lambda,
                  inout bool held[FREE_COUNT], inout float y[FREE_COUNT])
{
    float l[FREE_COUNT * FREE_COUNT];
    float pivot[FREE_COUNT];
    float right[FREE_COUNT];
    bool idle[FREE_COUNT];
    for (int i = 0; i < FREE_COUNT; i++) {
        right[i] = -slope[i];
        for (int k = 0; k < FREE_COUNT; k++) {
            if (held[k] && k != i) {
                right[i] -= a[min(i, k) * FREE_COUNT + max(i, k)] * y[k];
            }
        }
    }
    for (int j = 0; j < FREE_COUNT; j++) {
        float d = 1.0 + lambda;
        for (int k = 0; k < j; k++) {
            d -= idle[k] ? 0.0 : l[j * FREE_COUNT + k] * l[j * FREE_COUNT + k] * pivot[k];
        }
        idle[j] = held[j] || !(d > PIVOT);
        pivot[j] = idle[j] ? 1.0 : d;
        for (int i = j + 1; i < FREE_COUNT; i++) {
            float sum = a[j * FREE_COUNT + i];
            for (int k = 0; k < j; k++) {
                sum -= idle[k] ? 0.0 : l[i * FREE_COUNT + k] * l[j * FREE_COUNT + k] * pivot[k];
            }
            l[i * FREE_COUNT + j] = idle[j] ? 0.0 : sum / pivot[j];
        }
    }
    for (int i = 0; i < FREE_COUNT; i++) {
        for (int k = 0; k < i; k++) {
            right[i] -= idle[k] ? 0.0 : l[i * FREE_COUNT + k] * right[k];
        }
    }
    for (int i = FREE_COUNT - 1; i >= 0; i--) {
        float sum = right[i] / pivot[i];
        for (int k = i + 1; k < FREE_COUNT; k++) {
            sum -= idle[k] ? 0.0 : l[k * FREE_COUNT + i] * y[k];
        }
        if (!held[i]) {
            y[i] = idle[i] ? 0.0 : sum;
        }
    }
}

// How often the set of parameters at an end of their range is found again; after that, steps are cut off at the box.
#define BOX_ROUNDS 3

// The step inside the box, in fractions of the ranges; least and most bound each parameter's step. A parameter whose step
// would leave the box goes to its end, and the others are solved for again.
void boxed_step(inout float a[FREE_COUNT * FREE_COUNT], inout float slope[FREE_COUNT], inout float norm[FREE_COUNT],
                float lambda, inout float least[FREE_COUNT], inout float most[FREE_COUNT], out float step_by[FREE_COUNT])
{
    bool held[FREE_COUNT];
    float y[FREE_COUNT];
    for (int i = 0; i < FREE_COUNT; i++) {
        // A parameter stays if the render does not depend on it, or if it is at an end and would go beyond.
        held[i] = norm[i] == 0.0 || (slope[i] > 0.0 && least[i] >= 0.0) || (slope[i] < 0.0 && most[i] <= 0.0);
        y[i] = 0.0;
    }
    for (int round = 0; round < BOX_ROUNDS; round++) {
        solve_damped(a, slope, lambda, held, y);
        bool inside = true;
        for (int i = 0; i < FREE_COUNT; i++) {
            float by = norm[i] > 0.0 ? y[i] / norm[i] : 0.0;
            if (!held[i] && (by < least[i] || by > most[i])) {
                y[i] = norm[i] * clamp(by, least[i], most[i]);
                held[i] = true;
                inside = false;
            }
        }
        if (inside) {
            break;
        }
    }
    for (int i = 0; i < FREE_COUNT; i++) {
        float by = norm[i] > 0.0 ? y[i] / norm[i] : 0.0;
        // NaN is no step.
        step_by[i] = abs(by) <= 1e6 ? clamp(by, least[i], most[i]) : 0.0;
    }
}
