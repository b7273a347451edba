// Writes only the number of the triangle, counted from 1; 0 means none.

void main()
{
    out_triangle = float(v_triangle + 1);
}
