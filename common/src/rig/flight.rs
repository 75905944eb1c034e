/// Where a player or robot can hit: the plane y = `y_m` of the table frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HittingPlane {
    /// Distance from the net along the table's length, m; the table ends at ±1.37.
    pub y_m: f64,
}

impl Default for HittingPlane {
    fn default() -> Self {
        Self { y_m: -1.5 }
    }
}

/// Physical constants of the flight, to be fitted on real flights with `netcord predict --fit`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightConstants {
    /// Mass, kg; 0.0027 by the rules.
    pub mass_kg: f64,
    /// Acceleration of a ball let go in still air, m/s²: free fall less what buoyancy and the air that is
    /// carried along take, 1 − (m − ρV) / (m + ½ρV) = 2.2 %.
    pub gravity_m_s2: f64,
    /// Drag coefficient C_d in F = ½ ρ C_d A v².
    pub drag: f64,
    /// What lift adds to the drag coefficient, over the square of the lift coefficient.
    pub drag_induced: f64,
    /// Magnus coefficient C_M in F = C_M ρ V ω × v / √(1 + c² S²), S = r |ω × v| / v² being the spin
    /// parameter.
    pub magnus: f64,
    /// How soon lift saturates: c above; 0 for a force in proportion to the spin.
    pub magnus_saturation: f64,
    /// Density of the air ρ, kg/m³.
    pub air_density_kg_m3: f64,
    /// Normal restitution of the table at zero speed.
    pub restitution: f64,
    /// Loss of normal restitution per m/s of normal speed.
    pub restitution_slope_s_m: f64,
    /// Friction coefficient of the table.
    pub friction: f64,
}

impl Default for FlightConstants {
    /// Between what either half of 275 real flights (two amateurs' strokes, and balls from two launchers), chosen by
    /// a hash of their names, takes for the least prediction error (`netcord predict --evaluate`), with a last look
    /// at all; within what is published: drag 0.45–0.6 in flight with spin, table restitution 0.85–0.98 falling with
    /// speed, friction 0.25–0.3. The lift saturates near C_L = 0.3. Air at 20 °C and 101 kPa.
    ///
    /// Gravity is fitted, too: 1.6 % below the 9.81 m/s² of free fall. Buoyancy takes 1.5 % (33.5 cm³ of air weigh
    /// 0.040 g, the ball 2.7 g), to 9.66 m/s²; with the air that is carried along it would be 9.59 m/s².
    fn default() -> Self {
        Self {
            mass_kg: 0.0027,
            gravity_m_s2: 9.65,
            drag: 0.445,
            drag_induced: 1.4,
            magnus: 0.415,
            magnus_saturation: 3.5,
            air_density_kg_m3: 1.204,
            restitution: 0.9775,
            restitution_slope_s_m: 0.005,
            friction: 0.265,
        }
    }
}
