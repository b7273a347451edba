"""Other people's methods, written from their papers or taken from their libraries, to measure the program against."""
