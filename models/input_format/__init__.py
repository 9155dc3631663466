"""EnergyPlus's input formats, IDF and epJSON, of any version: positions of fields, reading, writing, the dictionary."""
