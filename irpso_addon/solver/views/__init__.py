"""Views of a recovery: renders, live pictures on the GPU, single texels, held-out photographs, convergence."""
