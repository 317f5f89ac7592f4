"""Every figure and HTML page. Takes values and arrays; computes no estimate."""
