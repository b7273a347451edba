// Closed form for what the radiance is linear in: weighted least squares over the observations, inside the ranges.
// basis.glsl is generated: void basis_at(Material s, vec3 l, vec3 v, out vec3 colors[COLOR_ROOM], out vec3
// numbers[NUMBER_ROOM], out vec3 rest): the bases of the COLORS weights of three components, of the NUMBERS weights of
// one, and the radiance that belongs to none of them; void linear_range(…) and void linear_to(…) go with it.

#include "basis.glsl"

// What the normal equations are summed up in. A colour's channels do not meet, so its part is diagonal.
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

// Adds one observation: bases under its light, radiance left for them to explain, weight of each channel.
void add_observation(inout Equations e, Material s, vec3 l, vec3 v, vec3 intensity, vec3 radiance, vec3 weight)
{
    vec3 colors[COLOR_ROOM];
    vec3 numbers[NUMBER_ROOM];
    vec3 rest;
    basis_at(s, l, v, colors, numbers, rest);
    vec3 right = radiance - intensity * rest;
    vec3 once = weight * intensity;
    vec3 twice = once * intensity;
    for (int i = 0; i < COLORS; i++) {
        e.color_right[i] += once * colors[i] * right;
        for (int j = 0; j <= i; j++) {
            e.color_color[i * COLOR_ROOM + j] += twice * colors[i] * colors[j];
        }
        for (int j = 0; j < NUMBERS; j++) {
            e.color_number[i * NUMBER_ROOM + j] += twice * colors[i] * numbers[j];
        }
    }
    for (int i = 0; i < NUMBERS; i++) {
        e.number_right[i] += dot(once * numbers[i], right);
        for (int j = 0; j <= i; j++) {
            e.number_number[i * NUMBER_ROOM + j] += dot(twice * numbers[i], numbers[j]);
        }
    }
}

// One weight at a time to its own optimum inside its range (coordinate descent, which the box cannot mislead). One
// sweep is exact for a single colour; lobes that overlap take several.
#if COLORS + NUMBERS > 1
#define LINEAR_SWEEPS 24
#else
#define LINEAR_SWEEPS 1
#endif

void solve_linear(inout Equations e, inout Linear w)
{
    vec2 color_range[COLOR_ROOM];
    vec2 number_range[NUMBER_ROOM];
    linear_range(color_range, number_range);
    for (int sweep = 0; sweep < LINEAR_SWEEPS; sweep++) {
        for (int i = 0; i < COLORS; i++) {
            vec3 right = e.color_right[i];
            for (int j = 0; j < COLORS; j++) {
                vec3 both = e.color_color[max(i, j) * COLOR_ROOM + min(i, j)];
                right -= j == i ? vec3(0.0) : both * w.colors[j];
            }
            for (int j = 0; j < NUMBERS; j++) {
                right -= e.color_number[i * NUMBER_ROOM + j] * w.numbers[j];
            }
            // 1e-20: a weight that no observation shows stays at its lowest.
            vec3 found = right / max(e.color_color[i * COLOR_ROOM + i], vec3(1e-20));
            w.colors[i] = clamp(found, vec3(color_range[i].x), vec3(color_range[i].y));
        }
        for (int i = 0; i < NUMBERS; i++) {
            float right = e.number_right[i];
            for (int j = 0; j < NUMBERS; j++) {
                float both = e.number_number[max(i, j) * NUMBER_ROOM + min(i, j)];
                right -= j == i ? 0.0 : both * w.numbers[j];
            }
            for (int j = 0; j < COLORS; j++) {
                vec3 both = e.color_number[j * NUMBER_ROOM + i];
                right -= dot(both, w.colors[j]);
            }
            float found = right / max(e.number_number[i * NUMBER_ROOM + i], 1e-20);
            w.numbers[i] = clamp(found, number_range[i].x, number_range[i].y);
        }
    }
}
