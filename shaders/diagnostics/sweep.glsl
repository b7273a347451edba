// Beaton's sweep of a symmetric matrix on unknown k (Goodnight 1979, A Tutorial on the SWEEP Operator). Once the set S
// is swept, the matrix holds −A_SS⁻¹ there, the Schur complement A_UU − A_US A_SS⁻¹ A_SU in the rest U, and between them
// A_SS⁻¹ A_SU: how S follows a change of U.
void sweep(inout float a[FREE_COUNT * FREE_COUNT], int k)
{
    float pivot = a[k * FREE_COUNT + k];
    float column[FREE_COUNT];
    for (int i = 0; i < FREE_COUNT; i++) {
        column[i] = a[i * FREE_COUNT + k];
    }
    for (int i = 0; i < FREE_COUNT; i++) {
        for (int m = 0; m < FREE_COUNT; m++) {
            a[i * FREE_COUNT + m] -= column[i] * column[m] / pivot;
        }
    }
    for (int i = 0; i < FREE_COUNT; i++) {
        a[i * FREE_COUNT + k] = column[i] / pivot;
        a[k * FREE_COUNT + i] = column[i] / pivot;
    }
    a[k * FREE_COUNT + k] = -1.0 / pivot;
}
