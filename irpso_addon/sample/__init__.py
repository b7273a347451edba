"""A capture to practise on: Cycles renders a glazed tile, a mirror ball and a colour chart; with ground truth."""
