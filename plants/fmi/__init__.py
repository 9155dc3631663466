"""FMUs as plants (Functional Mock-up Interface 2.0 and 3.0), simulated with FMPy."""
