"""`suturegrasp demo`: the whole dataflow on one machine, with a field of its own."""
