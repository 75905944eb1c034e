use super::{
    genapi::{FeatureError, FeatureInfo, GenApi, Value},
    gencp::Memory,
};

/// A description and the registers behind it: features by name.
pub trait FeatureAccess {
    /// The description, and the registers that it speaks of.
    fn parts(&mut self) -> (&mut GenApi, &mut dyn Memory);

    /// Whether the camera has a feature.
    fn has(&mut self, name: &str) -> bool {
        self.parts().0.has(name)
    }

    /// The value of a feature.
    ///
    /// # Errors
    /// [`FeatureError`].
    fn get(&mut self, name: &str) -> Result<Value, FeatureError> {
        let (api, memory) = self.parts();
        api.get(memory, name)
    }

    /// The value of a feature as a float.
    ///
    /// # Errors
    /// [`FeatureError`].
    fn get_float(&mut self, name: &str) -> Result<f64, FeatureError> {
        let (api, memory) = self.parts();
        api.get_float(memory, name)
    }

    /// The number behind a feature.
    ///
    /// # Errors
    /// [`FeatureError`].
    fn get_int(&mut self, name: &str) -> Result<i64, FeatureError> {
        let (api, memory) = self.parts();
        api.get_int(memory, name)
    }

    /// Sets a feature from text.
    ///
    /// # Errors
    /// [`FeatureError`].
    fn set(&mut self, name: &str, value: &str) -> Result<(), FeatureError> {
        let (api, memory) = self.parts();
        api.set(memory, name, value)
    }

    /// Carries a command out.
    ///
    /// # Errors
    /// [`FeatureError`].
    fn execute(&mut self, name: &str) -> Result<(), FeatureError> {
        let (api, memory) = self.parts();
        api.execute(memory, name)
    }

    /// All about a feature.
    ///
    /// # Errors
    /// [`FeatureError`].
    fn info(&mut self, name: &str) -> Result<FeatureInfo, FeatureError> {
        let (api, memory) = self.parts();
        api.info(memory, name)
    }
}
