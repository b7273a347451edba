"""What is drawn over the viewport and the Image editor while a recovery runs."""
