"""The live ECG: PLUS field data, the Lab Streaming Layer, or a file that grows."""
