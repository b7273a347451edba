// Linear weights: COLORS of three components, NUMBERS of one.

struct Linear {
    vec3 colors[COLOR_ROOM];
    float numbers[NUMBER_ROOM];
};
