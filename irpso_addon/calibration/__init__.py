"""What must be known of a capture before it is solved: lights from balls, linear and even images; numpy only."""
