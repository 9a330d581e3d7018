"""The program `aminn`: it puts simulation, training, export and pages together. Nothing imports it."""
