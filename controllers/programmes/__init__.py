"""What the laws share: task error, Lyapunov condition, condensed programmes, the QP solver."""
