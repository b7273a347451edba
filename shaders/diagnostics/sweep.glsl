// Beaton's sweep of a symmetric matrix on unknown k (Goodnight 1979, A Tutorial on the SWEEP Operator). After sweeps on
// the unknowns of a set S, with U the others, the matrix holds −A_SS⁻¹ in its block SS, the Schur complement
// A_UU − A_US A_SS⁻¹ A_SU in UU, and A_SS⁻¹ A_SU in SU: minus the change of S per change of U.
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
