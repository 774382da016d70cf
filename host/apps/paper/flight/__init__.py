"""The paper's section VI through the whole chain: plan, firmware, radio, log, learn, plan again."""
