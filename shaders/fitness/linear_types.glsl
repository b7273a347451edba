// Linear weights of a material: COLORS weights of three components, NUMBERS weights of one.

struct Linear {
    vec3 colors[COLOR_ROOM];
    float numbers[NUMBER_ROOM];
};
