"""The registration studies: experiments, scenes, baselines, summaries."""
