"""Systems of FMUs in SSP files (System Structure and Parameterization 1.0)."""
