"""Vehicle models: `rigid_body_6dof`, the paper's, and `quadrotor`, which can fly."""
