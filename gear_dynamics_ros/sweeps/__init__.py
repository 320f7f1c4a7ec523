"""Many runs at constant commands: a plan of points, their results, and the dataset made of them."""
