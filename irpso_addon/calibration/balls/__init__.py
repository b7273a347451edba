"""Light directions and positions from photographs of mirror and matte balls."""
