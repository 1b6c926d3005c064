"""Who does the work: one folder an agent, and the command line that knows them all."""
