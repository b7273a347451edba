// Keeps interchangeable lobes in rising order.
void order_lobes(inout float c[MAX_COMPONENTS])
{
#ifdef LOBE_FIRST
    if (c[LOBE_FIRST] > c[LOBE_SECOND]) {
        float swapped = c[LOBE_FIRST];
        c[LOBE_FIRST] = c[LOBE_SECOND];
        c[LOBE_SECOND] = swapped;
#ifdef LOBE_WEIGHT
        c[LOBE_WEIGHT] = 1.0 - c[LOBE_WEIGHT];
#endif
    }
#endif
}
