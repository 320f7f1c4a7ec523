"""Arrays in, arrays and numbers out; opens no file. Only ``figures`` imports matplotlib."""
