"""Error against work: what an answer costs, and what each reduction of the model buys."""
