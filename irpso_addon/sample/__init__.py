"""A capture to practise on: a glazed tile, a mirror ball and a colour chart, photographed by Cycles, and its truth."""
