"""Labels of end-diastole propagated through real cines, against an expert's at end-systole."""
