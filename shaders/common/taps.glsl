// Neighbours that a prior reads, TAPS in all: 5×5 texels, then rings of 16 at twice, four times, … the distance. A few
// dozen taps reach as far as a window of a thousand texels (à trous, with holes between the taps;
// Holschneider et al. 1989, A Real-Time Algorithm for Signal Analysis with the Help of the Wavelet Transform).

ivec2 tap_at(int t)
{
    if (t < 24) {
        int i = t < 12 ? t : t + 1;
        return ivec2(i % 5 - 2, i / 5 - 2);
    }
    int side = (t - 24) % 16 / 4;
    int along = (t - 24) % 4 - 2;
    ivec2 ring = side == 0 ? ivec2(along, -2) : side == 1 ? ivec2(2, along) : side == 2 ? ivec2(-along, 2)
                                                                                        : ivec2(-2, -along);
    return ring * (2 << ((t - 24) / 16));
}
