"""Does a building stay the same map, whatever its recording and its build hang on."""
