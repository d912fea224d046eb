"""Vehicle models: `rigid_body_6dof`, the paper's model, and `quadrotor`, a realistic one."""
