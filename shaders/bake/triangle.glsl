// Writes the number of the triangle, counted from 1. 0 means no triangle.

void main()
{
    out_triangle = float(v_triangle + 1);
}
