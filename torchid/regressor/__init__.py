"""The linear map from inertial parameters to wrenches, and its accumulated least-squares sums."""
