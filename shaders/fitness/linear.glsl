// Linear parameters in closed form: weighted least squares over the observations, bounded by the parameters' ranges.
// basis.glsl is generated: linear_range(…), linear_to(…) and void basis_at(Material s, vec3 l, vec3 v,
// out vec3 colors[COLOR_ROOM], out vec3 numbers[NUMBER_ROOM], out vec3 rest): the bases of the COLORS weights with
// three components, those of the NUMBERS weights with one, and the radiance that depends on no weight.

#include "basis.glsl"
#include "common/observation.glsl"

// Sums of the normal equations. The channels of a colour are independent, so its blocks are diagonal (vec3).
struct Equations {
    vec3 color_color[COLOR_ROOM * COLOR_ROOM];
    vec3 color_number[COLOR_ROOM * NUMBER_ROOM];
    float number_number[NUMBER_ROOM * NUMBER_ROOM];
    vec3 color_right[COLOR_ROOM];
    float number_right[NUMBER_ROOM];
};

void clear_equations(out Equations e)
{
    for (int i = 0; i < COLOR_ROOM; i++) {
        e.color_right[i] = vec3(0.0);
        for (int j = 0; j < COLOR_ROOM; j++) {
            e.color_color[i * COLOR_ROOM + j] = vec3(0.0);
        }
        for (int j = 0; j < NUMBER_ROOM; j++) {
            e.color_number[i * NUMBER_ROOM + j] = vec3(0.0);
        }
    }
    for (int i = 0; i < NUMBER_ROOM; i++) {
        e.number_right[i] = 0.0;
        for (int j = 0; j < NUMBER_ROOM; j++) {
            e.number_number[i * NUMBER_ROOM + j] = 0.0;
        }
    }
}

// Adds one observation to the normal equations. weight: of each channel.
void add_observation(inout Equations e, Material s, Observation o, vec3 weight)
{
    vec3 colors[COLOR_ROOM];
    vec3 numbers[NUMBER_ROOM];
    vec3 rest;
    basis_at(s, o.l, o.v, colors, numbers, rest);
    vec3 rhs = o.radiance - o.intensity * rest;
    vec3 weighted_intensity = weight * o.intensity;
    vec3 weighted_intensity2 = weighted_intensity * o.intensity;
    for (int i = 0; i < COLORS; i++) {
        e.color_right[i] += weighted_intensity * colors[i] * rhs;
        for (int j = 0; j <= i; j++) {
            e.color_color[i * COLOR_ROOM + j] += weighted_intensity2 * colors[i] * colors[j];
        }
        for (int j = 0; j < NUMBERS; j++) {
            e.color_number[i * NUMBER_ROOM + j] += weighted_intensity2 * colors[i] * numbers[j];
        }
    }
    for (int i = 0; i < NUMBERS; i++) {
        e.number_right[i] += dot(weighted_intensity * numbers[i], rhs);
        for (int j = 0; j <= i; j++) {
            e.number_number[i * NUMBER_ROOM + j] += dot(weighted_intensity2 * numbers[i], numbers[j]);
        }
    }
}

// solve_linear starts from the unbounded solution, because it converges slowly where bases are similar. Started from 0,
// 24 sweeps left a tenth of the prefit's particles 16 % above the lowest error. From here all reach it, up to rounding.
#if COLORS + NUMBERS > 1
#define LINEAR_SWEEPS 24
#define WEIGHTS (3 * COLORS + NUMBERS)
#define LINEAR_COLUMNS (WEIGHTS + 1)

// Unbounded least squares by Gaussian elimination. The matrix is symmetric and positive semidefinite: no pivoting.
void solve_unbounded(inout Equations e, inout Linear w)
{
    // Augmented matrix, row by row, right-hand side last. Colours come first, channel by channel.
    float m[WEIGHTS * LINEAR_COLUMNS];
    for (int i = 0; i < WEIGHTS * LINEAR_COLUMNS; i++) {
        m[i] = 0.0;
    }
    for (int i = 0; i < COLORS; i++) {
        for (int c = 0; c < 3; c++) {
            int row = (3 * i + c) * LINEAR_COLUMNS;
            for (int j = 0; j < COLORS; j++) {
                m[row + 3 * j + c] = e.color_color[max(i, j) * COLOR_ROOM + min(i, j)][c];
            }
            for (int j = 0; j < NUMBERS; j++) {
                float entry = e.color_number[i * NUMBER_ROOM + j][c];
                m[row + 3 * COLORS + j] = entry;
                m[(3 * COLORS + j) * LINEAR_COLUMNS + 3 * i + c] = entry;
            }
            m[row + WEIGHTS] = e.color_right[i][c];
        }
    }
    for (int i = 0; i < NUMBERS; i++) {
        int row = (3 * COLORS + i) * LINEAR_COLUMNS;
        for (int j = 0; j < NUMBERS; j++) {
            m[row + 3 * COLORS + j] = e.number_number[max(i, j) * NUMBER_ROOM + min(i, j)];
        }
        m[row + WEIGHTS] = e.number_right[i];
    }
    float inverse[WEIGHTS];
    for (int k = 0; k < WEIGHTS; k++) {
        inverse[k] = m[k * LINEAR_COLUMNS + k];  // the diagonal entry, until row k is eliminated
    }
    for (int k = 0; k < WEIGHTS; k++) {
        float pivot = m[k * LINEAR_COLUMNS + k];
        // 1e-6: below it the pivot is rounding, because earlier weights span this basis. The weight starts at 0.
        inverse[k] = pivot > max(1e-6 * inverse[k], 1e-20) ? 1.0 / pivot : 0.0;
        for (int i = k + 1; i < WEIGHTS; i++) {
            float factor = m[i * LINEAR_COLUMNS + k] * inverse[k];
            for (int j = k; j < LINEAR_COLUMNS; j++) {
                m[i * LINEAR_COLUMNS + j] -= factor * m[k * LINEAR_COLUMNS + j];
            }
        }
    }
    for (int k = WEIGHTS - 1; k >= 0; k--) {
        float rhs = m[k * LINEAR_COLUMNS + WEIGHTS];
        for (int j = k + 1; j < WEIGHTS; j++) {
            rhs -= m[k * LINEAR_COLUMNS + j] * m[j * LINEAR_COLUMNS + WEIGHTS];
        }
        m[k * LINEAR_COLUMNS + WEIGHTS] = rhs * inverse[k];
    }
    for (int i = 0; i < COLORS; i++) {
        for (int c = 0; c < 3; c++) {
            w.colors[i][c] = m[(3 * i + c) * LINEAR_COLUMNS + WEIGHTS];
        }
    }
    for (int i = 0; i < NUMBERS; i++) {
        w.numbers[i] = m[(3 * COLORS + i) * LINEAR_COLUMNS + WEIGHTS];
    }
}
#else
#define LINEAR_SWEEPS 1
#endif

// Coordinate descent: sets one weight at a time to its optimum inside its range. This converges for box constraints.
// For a single weight one sweep is exact.
void solve_linear(inout Equations e, inout Linear w)
{
    vec2 color_range[COLOR_ROOM];
    vec2 number_range[NUMBER_ROOM];
    linear_range(color_range, number_range);
#if COLORS + NUMBERS > 1
    solve_unbounded(e, w);
    for (int i = 0; i < COLORS; i++) {
        w.colors[i] = clamp(w.colors[i], vec3(color_range[i].x), vec3(color_range[i].y));
    }
    for (int i = 0; i < NUMBERS; i++) {
        w.numbers[i] = clamp(w.numbers[i], number_range[i].x, number_range[i].y);
    }
#endif
    for (int sweep = 0; sweep < LINEAR_SWEEPS; sweep++) {
        for (int i = 0; i < COLORS; i++) {
            vec3 rhs = e.color_right[i];
            for (int j = 0; j < COLORS; j++) {
                vec3 entry = e.color_color[max(i, j) * COLOR_ROOM + min(i, j)];
                rhs -= j == i ? vec3(0.0) : entry * w.colors[j];
            }
            for (int j = 0; j < NUMBERS; j++) {
                rhs -= e.color_number[i * NUMBER_ROOM + j] * w.numbers[j];
            }
            // 1e-20: a weight without observations takes the low end of its range.
            vec3 optimum = rhs / max(e.color_color[i * COLOR_ROOM + i], vec3(1e-20));
            w.colors[i] = clamp(optimum, vec3(color_range[i].x), vec3(color_range[i].y));
        }
        for (int i = 0; i < NUMBERS; i++) {
            float rhs = e.number_right[i];
            for (int j = 0; j < NUMBERS; j++) {
                float entry = e.number_number[max(i, j) * NUMBER_ROOM + min(i, j)];
                rhs -= j == i ? 0.0 : entry * w.numbers[j];
            }
            for (int j = 0; j < COLORS; j++) {
                vec3 entry = e.color_number[j * NUMBER_ROOM + i];
                rhs -= dot(entry, w.colors[j]);
            }
            float optimum = rhs / max(e.number_number[i * NUMBER_ROOM + i], 1e-20);
            w.numbers[i] = clamp(optimum, number_range[i].x, number_range[i].y);
        }
    }
}
